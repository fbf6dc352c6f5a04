"""The HTML report in a browser: drawing, interaction, narrow screens."""

import base64
import io
import json
from collections.abc import Iterator
from pathlib import Path

import chromium
import numpy as np
import pytest
from matplotlib.image import imread
from test_report import ball, hostile_page, page_of

from clradar.plot import depth_limits_mm

pytestmark = pytest.mark.skipif(
    chromium.installed() is None,
    reason="no Chromium here: install Debian's chromium package to try the page in a browser",
)

BLUR_PX = 2.0
"""Uncertainty of a cloud's middle on the canvas: points are drawn on whole pixels, and shadows have
no colour that is detected."""


BALLS = (ball(-0.02, -0.015, 0.29), ball(0.02, 0.015, 0.31))
"""In the radar's view the measured ball is to the right of the simulated one, lower and nearer."""


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[chromium.Page]:
    with chromium.chromium(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    (folder / "two.html").write_text(page_of(*BALLS), encoding="utf-8")
    (folder / "hostile.html").write_text(hostile_page(), encoding="utf-8")
    return folder


@pytest.fixture
def two(tab: chromium.Page, files: Path) -> chromium.Page:
    """The page of two balls on a desktop, its 3-D view on the screen."""
    tab.prefer("light")
    tab.resize(1000, 800)
    tab.open(files / "two.html")
    tab.js("document.getElementById('view').scrollIntoView({block: 'center'})")
    tab.settle()
    return tab


def pixels(page: chromium.Page) -> np.ndarray:
    """Return the canvas, shape (rows, columns, 3)."""
    address = page.js("document.getElementById('view').toDataURL()")
    shown = imread(io.BytesIO(base64.b64decode(address.split(",")[1])))
    return np.round(255 * shown[..., :3]).astype(int)


def middles(page: chromium.Page) -> tuple[np.ndarray, np.ndarray]:
    """Return where the measured (orange) and the simulated (blue) points are, (x, y) in pixels."""
    shown = pixels(page)
    warm = shown[..., 0] - shown[..., 2]
    found = []
    for mask in (warm > 40, warm < -40):
        rows, columns = np.nonzero(mask)
        # The middle of the extent: shadows do not move it.
        found.append(np.array([np.ptp(columns) / 2 + columns.min(), np.ptp(rows) / 2 + rows.min()]))
    return found[0], found[1]


def middle_of_view(page: chromium.Page) -> tuple[float, float]:
    frame = page.js(
        "(() => { const r = document.getElementById('view').getBoundingClientRect();"
        " return [r.left + r.width / 2, r.top + r.height / 2]; })()"
    )
    return frame[0], frame[1]


def press(page: chromium.Page, selector: str) -> None:
    page.js(f"document.querySelector({json.dumps(selector)}).click()")
    page.settle()


def test_no_complaints_and_no_network(two, files):
    assert two.complaints() == []
    addresses = two.requests()
    assert addresses[0] == (files / "two.html").as_uri()
    assert all(a.startswith("data:") for a in addresses[1:])
    assert two.js("document.querySelector('.figure img').naturalWidth") > 500


def test_front_is_the_view_of_the_radar(two):
    press(two, "[data-view=front]")
    measured, simulated = middles(two)
    # 40 mm apart along x, which increases to the left, and 30 mm along y, upwards.
    apart = measured - simulated
    assert apart[0] > 0
    assert apart[1] > 0
    assert apart[0] / apart[1] == pytest.approx(40 / 30, rel=2 * BLUR_PX / apart[1])


def test_a_drag_rotates(two):
    press(two, "[data-view=front]")
    before, (measured, simulated) = pixels(two), middles(two)
    two.drag(middle_of_view(two), (60, 0))
    assert (pixels(two) != before).any(axis=2).mean() > 0.01
    # What is nearer to the eye follows the hand: relative to the other, the measured ball.
    turned = middles(two)
    distance = measured[0] - simulated[0]
    mm = distance / 40
    expected = 40 * np.cos(0.48) * mm + 20 * np.sin(0.48) * mm  # 60 pixels are 0.48 radians
    assert turned[0][0] - turned[1][0] == pytest.approx(expected, abs=2 * BLUR_PX)
    press(two, "[data-view=front]")
    assert np.array_equal(pixels(two), before)


def test_wheel_keys_and_buttons_zoom(two):
    press(two, "[data-view=front]")
    before = np.subtract(*middles(two))
    two.js("document.getElementById('view').focus()")
    two.key("+")
    assert np.subtract(*middles(two)) == pytest.approx(1.25 * before, abs=2 * BLUR_PX)
    press(two, "[data-zoom='0.8']")
    assert np.subtract(*middles(two)) == pytest.approx(before, abs=2 * BLUR_PX)
    x, y = middle_of_view(two)
    two.mouse("mouseWheel", x, y, deltaX=0, deltaY=-100)
    two.settle()
    assert np.subtract(*middles(two)) == pytest.approx(np.exp(0.18) * before, abs=2 * BLUR_PX)
    two.key("ArrowLeft")
    two.key("0")
    start = pixels(two)
    press(two, "[data-view=start]")
    assert np.array_equal(pixels(two), start)


def test_colours_by_depth_come_with_a_scale(two):
    assert two.js("document.getElementById('scale').offsetHeight") == 0
    before = pixels(two)
    two.js(
        "(() => { const c = document.getElementById('colour'); c.value = 'depth';"
        " c.dispatchEvent(new Event('change')); })()"
    )
    two.settle()
    assert two.js("document.getElementById('scale').offsetHeight") > 0
    near_mm, far_mm = depth_limits_mm(BALLS)  # those of the figure
    assert two.js("document.getElementById('near').textContent") == f"{near_mm:g} mm"
    assert two.js("document.getElementById('far').textContent") == f"z = {far_mm:g} mm"
    assert not np.array_equal(pixels(two), before)


@pytest.mark.parametrize("name", ["two.html", "hostile.html"])
def test_it_fits_a_phone(tab, files, name):
    tab.prefer("light")
    tab.resize(360, 740, phone=True, ratio=2.0)
    tab.open(files / name)
    tab.js("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    tab.settle()
    assert tab.js("innerWidth") == 360  # a page that is wider makes a phone zoom out
    assert tab.js("document.documentElement.scrollWidth") == 360
    # Nothing sticks out but what scrolls in its own frame.
    assert tab.js(
        "[...document.querySelectorAll('body *')].filter(e => !e.closest('.figure')"
        " && e.getBoundingClientRect().right > 361).map(e => e.outerHTML.slice(0, 99))"
    ) == []  # fmt: skip
    assert tab.js("parseFloat(getComputedStyle(document.body).fontSize)") >= 16
    assert tab.complaints() == []


def test_fingers_rotate_and_zoom(tab, files):
    tab.prefer("light")
    tab.resize(360, 740, phone=True)
    tab.open(files / "two.html")
    tab.js("document.getElementById('view').scrollIntoView({block: 'center'})")
    press(tab, "[data-view=front]")
    before = np.subtract(*middles(tab))
    at = tab.js("scrollY")
    x, y = middle_of_view(tab)
    tab.touch("touchStart", (x - 40, y), (x + 40, y))
    for k in range(1, 5):
        tab.touch("touchMove", (x - 40 - 5 * k, y), (x + 40 + 5 * k, y))
    tab.touch("touchEnd")
    tab.settle()
    assert np.subtract(*middles(tab)) == pytest.approx(1.5 * before, abs=2 * BLUR_PX)
    zoomed = pixels(tab)
    tab.touch("touchStart", (x, y))
    tab.touch("touchMove", (x, y + 20))
    tab.touch("touchMove", (x, y + 40))
    tab.touch("touchEnd")
    tab.settle()
    assert not np.array_equal(pixels(tab), zoomed)
    assert tab.js("scrollY") == at  # the finger turned the view and did not move the page


def test_nothing_hostile_runs(tab, files):
    tab.resize(1000, 800)
    tab.open(files / "hostile.html")
    assert tab.js("typeof window.hacked") == "undefined"
    assert tab.js("document.querySelectorAll('h1').length") == 1
    assert tab.js("document.querySelectorAll('details').length") == 3
    assert tab.complaints() == []
    # Nor would it, were something not escaped: the policy stops it.
    tab.js(
        "(() => { const s = document.createElement('script'); s.textContent = 'window.hacked = 1';"
        " document.body.append(s); })()"
    )
    assert tab.js("typeof window.hacked") == "undefined"
    assert any("Content Security Policy" in text for text in tab.complaints())

"""The HTML report in a browser: drawing, interaction, linked slices, narrow screens."""

import base64
import io
import json

import chromium
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from test_report import FAR_M, MEASURED, NEAR_M, RANGE_DB, SIMULATED, ball, hostile_page, page_of

from clradar.plot.drawing import depth_limits_mm
from clradar.report import ReportImage, html_report

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
def tab(tmp_path_factory):
    with chromium.chromium(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    measured, simulated = ReportImage("measured", MEASURED), ReportImage("simulated", SIMULATED)
    texts = {"slices.html": html_report(measured, [simulated], dynamic_range_db=RANGE_DB)}
    with pytest.MonkeyPatch.context() as patch:  # the figure is most of the time
        patch.setattr("clradar.report.page.comparison_figure", lambda *_, **__: Figure())
        texts |= {"two.html": page_of(*BALLS), "hostile.html": hostile_page()}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def two(tab, files):
    """The page of two balls on a desktop, its 3-D view on the screen."""
    tab.prefer("light")
    tab.resize(1000, 800)
    tab.open(files / "two.html")
    tab.js("document.getElementById('view').scrollIntoView({block: 'center'})")
    tab.settle()
    return tab


def pixels(page, canvas="view"):
    """Return a canvas, shape (rows, columns, 3)."""
    address = page.js(f"document.getElementById('{canvas}').toDataURL()")
    shown = imread(io.BytesIO(base64.b64decode(address.split(",")[1])))
    return np.round(255 * shown[..., :3]).astype(int)


def middles(page):
    """Return where the measured (orange) and the simulated (blue) points are, (x, y) in pixels."""
    shown = pixels(page)
    warm = shown[..., 0] - shown[..., 2]
    found = []
    for mask in (warm > 40, warm < -40):
        rows, columns = np.nonzero(mask)
        # The middle of the extent: shadows do not move it.
        found.append(np.array([np.ptp(columns) / 2 + columns.min(), np.ptp(rows) / 2 + rows.min()]))
    return found[0], found[1]


def place_of(page, selector, right, down):
    """Where a fraction of an element's size is on the screen."""
    left, top, width, height = page.js(
        f"(() => {{ const r = document.querySelector({json.dumps(selector)})"
        ".getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; })()"
    )
    return left + right * width, top + down * height


def press(page, selector):
    page.js(f"document.querySelector({json.dumps(selector)}).click()")
    page.settle()


def test_front_is_the_view_of_the_radar_and_a_drag_rotates(two):
    press(two, "[data-view=front]")
    before, (measured, simulated) = pixels(two), middles(two)
    # 40 mm apart along x, which increases to the left, and 30 mm along y, upwards.
    apart = measured - simulated
    assert (apart > 0).all()
    assert apart[0] / apart[1] == pytest.approx(40 / 30, rel=2 * BLUR_PX / apart[1])
    two.drag(place_of(two, "#view", 0.5, 0.5), (60, 0))
    # What is nearer to the eye follows the hand: relative to the other, the measured ball.
    turned = middles(two)
    mm = apart[0] / 40
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
    two.mouse("mouseWheel", *place_of(two, "#view", 0.5, 0.5), deltaX=0, deltaY=-100)
    two.settle()
    assert np.subtract(*middles(two)) == pytest.approx(np.exp(0.18) * before, abs=2 * BLUR_PX)


def test_colours_by_depth_come_with_a_scale(two):
    assert two.js("document.getElementById('scale').offsetHeight") == 0
    before = pixels(two)
    two.js(
        "(() => { const c = document.getElementById('colour'); c.value = 'depth';"
        " c.dispatchEvent(new Event('change')); })()"
    )
    two.settle()
    near_mm, far_mm = depth_limits_mm(BALLS)  # those of the figure
    assert two.js("document.getElementById('near').textContent") == f"{near_mm:g} mm"
    assert two.js("document.getElementById('far').textContent") == f"z = {far_mm:g} mm"
    assert not np.array_equal(pixels(two), before)


def test_it_fits_a_phone(tab, files):
    tab.prefer("light")
    tab.resize(360, 740, phone=True, ratio=2.0)
    tab.open(files / "hostile.html")
    tab.js("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    tab.settle()
    assert tab.js("innerWidth") == 360  # a page that is wider makes a phone zoom out
    assert tab.js("document.documentElement.scrollWidth") == 360
    # Nothing sticks out but what scrolls in its own frame.
    wide = tab.js(
        "[...document.querySelectorAll('body *')].filter(e => !e.closest('.figure')"
        " && e.getBoundingClientRect().right > 361).map(e => e.outerHTML.slice(0, 99))"
    )
    assert wide == []
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
    x, y = place_of(tab, "#view", 0.5, 0.5)
    tab.touch("touchStart", (x - 40, y), (x + 40, y))
    for k in range(1, 5):
        tab.touch("touchMove", (x - 40 - 5 * k, y), (x + 40 + 5 * k, y))
    tab.touch("touchEnd")
    tab.settle()
    assert np.subtract(*middles(tab)) == pytest.approx(1.5 * before, abs=2 * BLUR_PX)
    zoomed = pixels(tab)
    for kind, *points in (("touchStart", (x, y)), ("touchMove", (x, y + 40)), ("touchEnd",)):
        tab.touch(kind, *points)
    tab.settle()
    assert not np.array_equal(pixels(tab), zoomed)
    assert tab.js("scrollY") == at  # the finger turned the view and did not move the page


def test_nothing_hostile_runs(tab, files):
    tab.resize(1000, 800)
    tab.open(files / "hostile.html")
    assert tab.js("typeof window.hacked") == "undefined"
    assert tab.complaints() == []
    # Nor would it, were something not escaped: the policy stops it.
    tab.js(
        "(() => { const s = document.createElement('script'); s.textContent = 'window.hacked = 1';"
        " document.body.append(s); })()"
    )
    assert tab.js("typeof window.hacked") == "undefined"
    assert any("Content Security Policy" in text for text in tab.complaints())


# ---- linked slices


@pytest.fixture
def slices(tab, files):
    tab.prefer("light")
    tab.resize(1000, 2800)  # all of it on the screen
    tab.open(files / "slices.html")
    tab.js(
        "new Promise(done => { const c = document.getElementById('slices'); const look = () =>"
        " c.dataset.ready ? done() : requestAnimationFrame(look); look(); })"
    )
    tab.settle()
    return tab


def place(page):
    """The place that is shown, millimetres."""
    texts = page.js("['x', 'y', 'z'].map(a => document.getElementById('at-' + a).textContent)")
    return [float(text.split()[0].replace("\N{MINUS SIGN}", "-")) for text in texts]


def click(page, element, right, down):
    """Click at fractions of an element's size."""
    page.js(f"document.querySelector({json.dumps(element)}).scrollIntoView({{block: 'center'}})")
    at = place_of(page, element, right, down)
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, *at, button="left", clickCount=1)
    page.settle()


def bright(page):
    """Bright pixels in each half of the slices' canvas: measured, simulated."""
    red, green, blue = np.moveaxis(pixels(page, "slices"), 2, 0)
    lit = (red > 200) & (green > 90) & (blue < 120)
    return [int(half.sum()) for half in np.array_split(lit, 2, axis=1)]


def test_slices_open_at_the_maximum_and_ask_nobody(slices):
    assert place(slices) == pytest.approx(1e3 * np.array(NEAR_M), abs=1)
    measured, simulated = bright(slices)
    assert measured > 4 * max(simulated, 1)  # the simulated ball is 8 dB below its maximum here
    assert slices.complaints() == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in slices.requests())
    assert slices.js("document.querySelector('.figure img').naturalWidth") > 500


def test_a_click_on_a_point_or_in_the_figure_moves_all_slices(slices):
    press(slices, "[data-view=front]")
    press(slices, '[data-cloud="0"]')  # the simulated alone
    shown = pixels(slices)
    rows, columns = np.nonzero(shown[..., 0] - shown[..., 2] < -120)
    click(slices, "#view", columns.mean() / shown.shape[1], rows.mean() / shown.shape[0])
    # Its depth points are on the near side of the brighter ball.
    before = place(slices)
    assert before[:2] == pytest.approx([1e3 * v for v in FAR_M[:2]], abs=8)
    slices.drag(place_of(slices, "#view", 0.5, 0.5), (50, 10))
    assert place(slices) == before  # a drag rotates
    panel = slices.js("report.data.panels[1]")  # the simulated amplitude
    (left, low, right, high), x, y = panel["box"], panel["x"], panel["y"]
    across = left + (right - left) * (1e3 * FAR_M[0] - x[0]) / (x[1] - x[0])
    up = low + (high - low) * (1e3 * FAR_M[1] - y[0]) / (y[1] - y[0])
    click(slices, ".figure img", across, 1 - up)
    assert place(slices) == pytest.approx(1e3 * np.array(FAR_M), abs=2)  # the pixels' size
    measured, simulated = bright(slices)
    assert simulated > measured


def test_clicks_in_slices_and_keys_on_sliders_move_the_place(slices):
    x, y, z = place(slices)
    slices.js("document.getElementById('place-z').focus()")
    slices.key("ArrowRight")
    assert place(slices) == [x, y, z + 2]  # one voxel
    # The upper left panel of the first image: in its lower left corner x is high and y low.
    click(slices, "#slices", 45 / 1000, 0.5)
    moved = place(slices)
    assert moved[0] > x
    assert moved[2] == z + 2
    assert slices.complaints() == []

"""Linked slices of the HTML report: the volumes in the page, and clicks in a browser."""

import base64
import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import chromium
import numpy as np
import pytest
from test_report import Read

from clradar import Volume, VoxelGrid
from clradar.report import ReportImage, html_report, image_report
from clradar.report import view_data as slices_module
from clradar.report.view_data import slice_data

RANGE_DB = 20.0
NEAR_M, FAR_M = (-0.012, -0.02, 0.29), (0.02, 0.016, 0.31)
"""Two balls; the measured one is brighter at the first, the simulated one at the second place."""


def balls(levels: tuple[float, float], spacing_m: float = 2e-3) -> Volume:
    grid = VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.25, 0.35), spacing_m)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    data = np.full(grid.shape, 1e-6)
    for level, (x0, y0, z0) in zip(levels, (NEAR_M, FAR_M), strict=True):
        data += level * np.exp(-((x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2) / 0.006**2)
    return Volume(data, grid)


MEASURED, SIMULATED = balls((1.0, 0.5)), balls((0.4, 1.0))


def decoded(part: dict[str, Any]) -> np.ndarray:
    """Levels of a volume in the page, dB, shape (nz, ny, nx); NaN below the dynamic range."""
    codes = np.frombuffer(zlib.decompress(base64.b64decode(part["codes"])), np.uint8)
    level_db = -RANGE_DB * (1 - (codes.astype(float) - 1) / 254)
    return np.where(codes == 0, np.nan, level_db).reshape(part["counts"][::-1])


def test_the_volumes_are_in_the_page_as_far_as_they_are_seen():
    data = slice_data([("a", MEASURED), ("b", SIMULATED)], RANGE_DB)
    assert data is not None
    assert data["factor"] == 1
    for volume, part in zip((MEASURED, SIMULATED), data["volumes"], strict=True):
        shown_db = decoded(part)
        level_db = 20 * np.log10(np.abs(volume.data) / np.abs(volume.data).max())
        grid = volume.grid
        first = np.round((np.array(part["origin"]) - 1e3 * grid.origin_m) / part["step"])
        z, y, x = (
            slice(int(i), int(i) + n)
            for i, n in zip(first[::-1], part["counts"][::-1], strict=True)
        )
        inside = np.zeros(grid.shape, bool)
        inside[z, y, x] = True
        assert not (level_db[~inside] > -RANGE_DB).any()
        assert shown_db.size < level_db.size / 2
        expected = level_db[z, y, x]
        assert np.array_equal(np.isnan(shown_db), expected <= -RANGE_DB)
        assert np.nanmax(np.abs(shown_db - expected)) <= RANGE_DB / 254 / 2 + 1e-4


def test_large_volumes_get_coarser_and_keep_their_maximum(monkeypatch):
    rng = np.random.default_rng(0)
    levels = 1 + rng.random(MEASURED.grid.shape)
    levels[11, 30, 40] = 3.0
    noise = Volume(levels, MEASURED.grid)
    whole = slice_data([("a", noise)], RANGE_DB)
    monkeypatch.setattr(slices_module, "MAX_PACKED_BYTES", 5000)
    data = slice_data([("a", noise)], RANGE_DB)
    assert whole is not None
    assert data is not None
    assert len(base64.b64decode(data["volumes"][0]["codes"])) <= 5000
    assert data["factor"] > 1
    assert np.nanmax(decoded(data["volumes"][0])) == 0
    places = []
    for one in (whole, data):
        part = one["volumes"][0]
        i = np.unravel_index(np.nanargmax(decoded(part)), part["counts"][::-1])[::-1]
        places.append(np.array(part["origin"]) + np.array(i) * part["step"])
    assert (np.abs(places[1] - places[0]) <= np.array(data["volumes"][0]["step"]) / 2).all()
    page = image_report(ReportImage("noise", noise), dynamic_range_db=RANGE_DB)
    assert f"maximum of {data['factor']} along each axis" in page


def test_depth_maps_have_no_slices():
    image = ReportImage("map", MEASURED.depth_map(RANGE_DB))
    read = Read(image_report(image, dynamic_range_db=RANGE_DB))
    assert read.data()["slices"] is None
    assert [a for t, a in read.tags if a.get("id") == "slices-section"] == [
        {"id": "slices-section", "hidden": None}
    ]


needs_browser = pytest.mark.skipif(
    chromium.installed() is None, reason="no Chromium here: install Debian's chromium package"
)


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[chromium.Page]:
    with chromium.chromium(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "two.html"
    measured, simulated = ReportImage("measured", MEASURED), ReportImage("simulated", SIMULATED)
    text = html_report(measured, [simulated], dynamic_range_db=RANGE_DB)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def page(tab: chromium.Page, report: Path) -> chromium.Page:
    tab.prefer("light")
    tab.resize(1000, 2800)  # all of it on the screen
    tab.open(report)
    tab.js(
        "new Promise(done => { const c = document.getElementById('slices'); const look = () =>"
        " c.dataset.ready ? done() : requestAnimationFrame(look); look(); })"
    )
    tab.settle()
    return tab


def place(page: chromium.Page) -> list[float]:
    """The place that is shown, millimetres."""
    texts = page.js("['x', 'y', 'z'].map(a => document.getElementById('at-' + a).textContent)")
    return [float(text.split()[0].replace("\N{MINUS SIGN}", "-")) for text in texts]


def click(page: chromium.Page, element: str, right: float, down: float) -> None:
    """Click at fractions of an element's size."""
    found = json.dumps(element)
    page.js(f"document.querySelector({found}).scrollIntoView({{block: 'center'}})")
    box = page.js(
        f"(() => {{ const r = document.querySelector({found}).getBoundingClientRect();"
        " return [r.left, r.top, r.width, r.height]; })()"
    )
    x, y = box[0] + right * box[2], box[1] + down * box[3]
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, x, y, button="left", clickCount=1)
    page.settle()


def bright(page: chromium.Page) -> np.ndarray:
    """Bright pixels in each half of the slices' canvas: measured, simulated."""
    counts = page.js(
        "(() => { const c = document.getElementById('slices');"
        " const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        " const found = [0, 0]; for (let i = 0; i < d.length; i += 4)"
        " if (d[i] > 200 && d[i + 1] > 90 && d[i + 2] < 120)"
        " found[Number((i / 4) % c.width >= c.width / 2)]++; return found; })()"
    )
    return np.array(counts)


@needs_browser
def test_it_opens_at_the_maximum_and_asks_nobody(page):
    assert place(page) == pytest.approx(1e3 * np.array(NEAR_M), abs=1)
    measured, simulated = bright(page)
    assert measured > 4 * max(simulated, 1)  # the simulated ball is 8 dB below its maximum here
    assert page.complaints() == []
    assert all(address.startswith(("file:", "data:", "blob:")) for address in page.requests())


@needs_browser
def test_a_click_in_the_figure_moves_all_slices(page):
    panel = page.js("report.data.panels[1]")  # the simulated amplitude
    (left, low, right, high), x, y = panel["box"], panel["x"], panel["y"]
    across = left + (right - left) * (1e3 * FAR_M[0] - x[0]) / (x[1] - x[0])
    up = low + (high - low) * (1e3 * FAR_M[1] - y[0]) / (y[1] - y[0])
    click(page, ".figure img", across, 1 - up)
    assert place(page) == pytest.approx(1e3 * np.array(FAR_M), abs=2)  # the pixels' size
    measured, simulated = bright(page)
    assert simulated > measured


@needs_browser
def test_a_click_on_a_point_moves_all_slices(page):
    page.js("document.querySelector('[data-view=front]').click()")
    page.js("document.querySelector('[data-cloud=\"0\"]').click()")  # the simulated alone
    page.settle()
    box = page.js(
        "(() => { const c = document.getElementById('view');"
        " const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        " let [n, x, y] = [0, 0, 0];"
        " for (let i = 0; i < d.length; i += 4) if (d[i] - d[i + 2] < -120)"
        " { n++; x += (i / 4) % c.width; y += Math.floor(i / 4 / c.width); }"
        " return [x / n / c.width, y / n / c.height]; })()"
    )
    click(page, "#view", *box)
    # Its depth points are on the near side of the brighter ball.
    assert place(page)[:2] == pytest.approx([1e3 * v for v in FAR_M[:2]], abs=8)
    before = place(page)
    page.drag(
        page.js(
            "(() => { const r = document.getElementById('view').getBoundingClientRect();"
            " return [r.left + r.width / 2, r.top + r.height / 2]; })()"
        ),
        (50, 10),
    )
    assert place(page) == before  # a drag rotates


@needs_browser
def test_clicks_in_slices_and_keys_on_sliders_move_the_place(page):
    x, y, z = place(page)
    page.js("document.getElementById('place-z').focus()")
    page.key("ArrowRight")
    assert place(page) == [x, y, z + 2]  # one voxel
    # The upper left panel of the first image: in its lower left corner x is high and y low.
    click(page, "#slices", 45 / 1000, 0.5)
    moved = place(page)
    assert moved[0] > x
    assert moved[2] == z + 2
    assert page.complaints() == []


@needs_browser
def test_an_old_browser_is_told(tab, page):
    added = tab.call(
        "Page.addScriptToEvaluateOnNewDocument", source="delete window.DecompressionStream"
    )
    tab.open(tab.js("location.href"))
    tab.js(
        "new Promise(done => { const look = () => document.getElementById('slices')"
        " ? requestAnimationFrame(look) : done(); look(); })"
    )
    section = tab.js("document.getElementById('slices-section').textContent")
    assert "needs a newer browser" in section
    tab.call("Page.removeScriptToEvaluateOnNewDocument", identifier=added["identifier"])

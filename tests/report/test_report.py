"""The HTML report: its content, and the escaping of untrusted text."""

import base64
import hashlib
import json
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import exit_status
from matplotlib.figure import Figure

from clradar import Volume, VoxelGrid, compare
from clradar.compare.metrics import METRIC_TABLE
from clradar.model import DepthMap
from clradar.report import ReportImage, html_report, image_report, view_data
from clradar.report.tables import settings_table
from clradar.report.view_data import MAX_POINTS, clouds, slice_data
from measurement_io import save_volume

HOSTILE = "<script>window.hacked = 1</script>"
HOSTILE_META = {
    "</script><script>window.hacked = 1</script>": "</script>",
    "nested": {"list": [{"<img src=x onerror='window.hacked=1'>": '"><b>'}], "none": None},
    "quote": '" onload="window.hacked=1\' &amp; \u202e\x00\x1b[31m \udcff',
}

PAGE_BYTES = 3e6
"""Largest page of the paper's grid without its figure, with every pixel of two images a point."""


@pytest.fixture(autouse=True)
def empty_figures(monkeypatch):
    """Drawing the figure is most of the time; `test_report_browser` does it."""
    for kind in ("comparison", "image"):
        monkeypatch.setattr(f"clradar.report.page.{kind}_figure", lambda *_, **__: Figure())


def ball(x_m=0.0, y_m=0.0, z_m=0.3, n=61):
    """The near side of a ball of 12 mm, on n x n pixels of 2 mm, brightest in the middle."""
    axis_m = 2e-3 * (np.arange(n) - n // 2)
    away_m = np.hypot(axis_m - x_m, (axis_m - y_m)[:, None])
    inside = away_m < 0.012
    depth_m = np.where(inside, z_m - np.sqrt(np.maximum(0.012**2 - away_m**2, 0)), np.nan)
    amplitude = np.where(inside, np.exp(-((away_m / 0.012) ** 2)), 0.0)
    return DepthMap(depth_m, amplitude, axis_m, axis_m)


def blob(grid, x_m, y_m, z_m):
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    return np.exp(-((x - x_m) ** 2 + (y - y_m) ** 2 + (z - z_m) ** 2) / 0.006**2)


def volume(meta, x_m=0.0):
    """A small volume with a blob in it."""
    grid = VoxelGrid.from_extent((-0.03, 0.03), (-0.03, 0.03), (0.28, 0.32), 2e-3)
    return Volume(blob(grid, x_m, 0.0, 0.3), grid, meta)


def page_of(*images, **options):
    measured, *others = (ReportImage(f"image {i}", m) for i, m in enumerate(images))
    return html_report(measured, others, **options)


class Read(HTMLParser):
    """Tags and text of a page."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.inside: dict[str, list[str]] = {}
        self._open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._open.append(tag)
        self.inside.setdefault(tag, []).append("")

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data):
        for tag in {*self._open}:
            self.inside[tag][-1] += data

    def data(self):
        found: dict[str, Any] = json.loads(self.inside["script"][0])
        return found


def hostile_page():
    measured = ReportImage(HOSTILE, volume(HOSTILE_META), HOSTILE)
    simulated = ReportImage("'\"><h1>" + "x" * 300, volume({}, 2e-3), "a\n</details>")
    return html_report(
        measured, [simulated], title=HOSTILE, notes=[HOSTILE, "a\nb"], settings=HOSTILE_META
    )


def test_nothing_is_loaded_and_one_script_runs():
    page = page_of(ball(), ball(2e-3))
    read = Read(page)
    for tag, attributes in read.tags:
        for name in ("src", "href", "srcset", "action", "data"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, name)
        assert not [name for name in attributes if name.startswith("on") or name == "style"]
    assert "url(" not in page
    assert "@import" not in page
    assert [a.get("type") for t, a in read.tags if t == "script"] == ["application/json", None]
    policy = next(a["content"] for t, a in read.tags if a.get("http-equiv"))
    assert policy.startswith("default-src 'none';")
    for part, content in (("script", read.inside["script"][1]), ("style", read.inside["style"][0])):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{part}-src 'sha256-{digest}';" in policy


def test_text_of_files_is_escaped():
    hostile = hostile_page()
    tame, read = Read(page_of(ball(), ball(2e-3))), Read(hostile)
    counts = [[t for t, _ in r.tags] for r in (tame, read)]
    for tag in ("script", "style", "h1", "img", "b", "canvas", "html", "body"):
        assert counts[0].count(tag) == counts[1].count(tag), tag
    assert read.inside["h1"] == [HOSTILE]
    assert read.inside["title"] == [HOSTILE]
    assert read.inside["summary"][0] == HOSTILE
    cells = read.inside["td"]
    assert HOSTILE in cells
    assert "</script>" in cells
    assert '"><b>' in cells
    # Invisible characters are shown, so that no name passes for another.
    assert '" onload="window.hacked=1\' &amp; \\u202e\\x00\\x1b[31m \\udcff' in cells
    hostile.encode("utf-8")


def test_the_points_are_those_of_the_depth_maps():
    images = [ball(), ball(4e-3, -6e-3, 0.31)]
    data = Read(page_of(*images)).data()
    assert data["pixel_mm"] == pytest.approx(2.0)
    for image, cloud in zip(images, data["clouds"], strict=True):
        points = np.frombuffer(base64.b64decode(cloud["points_mm"]), "<f4").reshape(-1, 3)
        assert np.array_equal(points, (1e3 * image.points_m()).astype(np.float32))
        level = np.frombuffer(base64.b64decode(cloud["level"]), np.uint8)
        relative = image.amplitude[image.mask] / image.amplitude.max()
        expected = 255 * (1 + 20 * np.log10(relative) / image.dynamic_range_db)
        assert np.abs(level - expected).max() <= 0.5 + 1e-3  # rounded to whole levels
        assert level.max() == 255


def test_too_many_points_are_subsampled_and_counted():
    rng = np.random.default_rng(0)
    axis_m = 1e-3 * (np.arange(201) - 100)
    ones = np.ones((201, 201))
    depths_m = 0.3 + 0.01 * rng.random((2, 201, 201))
    full = [DepthMap(depth_m, ones, axis_m, axis_m) for depth_m in depths_m]
    page = page_of(*full)
    assert len(page) < PAGE_BYTES
    assert page.count(f"{MAX_POINTS // 2} of {201 * 201} points") == 2
    there = {tuple(p) for p in (1e3 * full[1].points_m()).astype(np.float32)}
    kept = {tuple(p) for p in clouds(full)[1].points_mm}
    assert len(kept) == MAX_POINTS // 2
    assert kept <= there
    found = clouds([ball(), full[0], full[0]], most=600)
    assert [len(c.points_mm) for c in found] == [found[0].total, 200, 200]


def test_metrics_are_listed_with_their_meaning():
    images = [ball(), ball(2e-3), ball(8e-3)]
    read = Read(page_of(*images))
    metrics = [compare(images[0], m) for m in images[1:]]
    shown = [a["data-name"] for t, a in read.tags if t == "td" and a.get("data-name") is not None]
    assert shown == 2 * [m.name for m in METRIC_TABLE]
    values = read.inside["td"][: len(shown)]
    for row, m in enumerate(metrics):
        cells = values[len(METRIC_TABLE) * row :][: len(METRIC_TABLE)]
        for cell, text in zip(cells, METRIC_TABLE, strict=True):
            wanted = pytest.approx(text.scale * getattr(m, text.field), abs=0.5 * 10**-text.digits)
            assert float(cell.replace("\N{MINUS SIGN}", "-")) == wanted
    # The nearer ball is better in all of them.
    assert read.inside["strong"] == values[: len(METRIC_TABLE)]
    assert len(read.inside["dd"]) == len(METRIC_TABLE)

    apart = Read(page_of(ball(-0.03), ball(0.03)))
    assert "n/a" in apart.inside["td"]
    assert sum("no pixel in common" in text for text in apart.inside["dd"]) == 1
    assert "no pixel in common" not in page_of(ball(), ball())


def test_enormous_settings_are_cut_visibly():
    deep: Any = 1
    for _ in range(200):
        deep = {"k": deep}
    table = settings_table({"deep": deep, "long": "y" * 10_000})
    assert "k.k.k" in table
    assert "(284 more characters)" in table
    assert "(9600 more characters)" in table
    assert "800 more rows are omitted" in settings_table({str(i): i for i in range(1000)})


def test_compare_writes_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "<img src=x onerror=alert(1)>.h5"
    save_volume("measured.h5", volume({"antenna": "</script>"}))
    save_volume(name, volume({"kind": "simulated", "seed": 41}, 2e-3))
    options = ("--report", "report.html", "--dynamic-range-db", "20")
    assert exit_status("compare", "measured.h5", name, *options) == 0
    read = Read(Path("report.html").read_text(encoding="utf-8"))
    assert len([t for t, _ in read.tags if t == "script"]) == 2
    assert len([t for t, _ in read.tags if t == "img"]) == 1
    assert read.inside["summary"] == ["Measurement", name.removesuffix(".h5"), "This page"]
    cells = read.inside["td"]
    for expected in ("measured.h5", name, "41", "</script>", "compare", "fast"):
        assert expected in cells
    digest = hashlib.sha256(Path("measured.h5").read_bytes()).hexdigest()
    assert digest in cells
    assert any("within 20 dB" in cell for cell in cells)


# ---- linked slices

RANGE_DB = 20.0
NEAR_M, FAR_M = (-0.012, -0.02, 0.29), (0.02, 0.016, 0.31)
"""Two balls; the measured one is brighter at the first, the simulated one at the second place."""


def balls(levels):
    grid = VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.25, 0.35), 2e-3)
    near, far = (blob(grid, *at_m) for at_m in (NEAR_M, FAR_M))
    return Volume(1e-6 + levels[0] * near + levels[1] * far, grid)


MEASURED, SIMULATED = balls((1.0, 0.5)), balls((0.4, 1.0))


def decoded(part):
    """Levels of a volume in the page, dB, shape (nz, ny, nx); NaN below the dynamic range."""
    codes = np.frombuffer(zlib.decompress(base64.b64decode(part["codes"])), np.uint8)
    level_db = -RANGE_DB * (1 - (codes.astype(float) - 1) / 254)
    return np.where(codes == 0, np.nan, level_db).reshape(part["counts"][::-1])


def test_the_volumes_are_in_the_page_as_far_as_they_are_seen():
    data = slice_data([("a", MEASURED), ("b", SIMULATED)], RANGE_DB)
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
    grid = VoxelGrid.from_extent((-0.03, 0.03), (-0.03, 0.03), (0.28, 0.32), 2e-3)
    levels = 1 + rng.random(grid.shape)
    levels[11, 10, 20] = 3.0
    noise = Volume(levels, grid)
    whole = slice_data([("a", noise)], RANGE_DB)
    monkeypatch.setattr(view_data, "MAX_PACKED_BYTES", 1000)
    data = slice_data([("a", noise)], RANGE_DB)
    assert len(base64.b64decode(data["volumes"][0]["codes"])) <= 1000
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

"""The HTML report: its content, and the escaping of untrusted text."""

import base64
import hashlib
import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import exit_status
from matplotlib.figure import Figure

from clradar import Volume, VoxelGrid, compare
from clradar.compare import METRIC_TABLE, METRICS
from clradar.errors import CompareError, ModelError
from clradar.model import DepthMap
from clradar.plot import comparison_figure
from clradar.report import ReportImage, html_report
from clradar.report.tables import settings_table
from clradar.report.view_data import MAX_POINTS, clouds
from measurement_io import save_volume

HOSTILE = "<script>window.hacked = 1</script>"
NO_TEXT = "a\udcff\x1b[31m"
"""A file's name with undecodable bytes and a control character."""
HOSTILE_META = {
    "</script><script>window.hacked = 1</script>": "</script>",
    "nested": {"list": [{"<img src=x onerror='window.hacked=1'>": '"><b>'}], "none": None},
    "quote": '" onload="window.hacked=1\' &amp; \u202e\x00\x1b[31m \udcff',
}

PAGE_BYTES = 3e6
"""Largest page of the paper's grid, with every pixel of two images a point."""


@pytest.fixture(autouse=True)
def empty_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing the figure is most of the time; one test does it."""
    monkeypatch.setattr("clradar.report.page.comparison_figure", lambda *_, **__: Figure())


def ball(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.3, n: int = 61) -> DepthMap:
    """The near side of a ball of 12 mm, on n x n pixels of 2 mm, brightest in the middle."""
    axis_m = 2e-3 * (np.arange(n) - n // 2)
    away_m = np.hypot(axis_m - x_m, (axis_m - y_m)[:, None])
    inside = away_m < 0.012
    depth_m = np.where(inside, z_m - np.sqrt(np.maximum(0.012**2 - away_m**2, 0)), np.nan)
    amplitude = np.where(inside, np.exp(-((away_m / 0.012) ** 2)), 0.0)
    return DepthMap(depth_m, amplitude, axis_m, axis_m)


def volume(meta: dict[str, Any], x_m: float = 0.0) -> Volume:
    """A small volume with a blob in it."""
    grid = VoxelGrid.from_extent((-0.03, 0.03), (-0.03, 0.03), (0.28, 0.32), 2e-3)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    return Volume(np.exp(-((x - x_m) ** 2 + y**2 + (z - 0.3) ** 2) / 0.006**2), grid, meta)


def page_of(*images: DepthMap, **options: Any) -> str:
    measured, *others = (ReportImage(f"image {i}", m) for i, m in enumerate(images))
    return html_report(measured, others, **options)


class Read(HTMLParser):
    """Tags and text of a page."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.inside: dict[str, list[str]] = {}
        self._open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open.append(tag)
        self.inside.setdefault(tag, []).append("")

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        for tag in {*self._open}:
            self.inside[tag][-1] += data

    def data(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.inside["script"][0])
        return found


def hostile_page() -> str:
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
    assert policy is not None
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
    assert (
        '" onload="window.hacked=1\' &amp; \\u202e\\x00 \\x1b[31m \\udcff'.replace(
            "\\x00 ", "\\x00"
        )
        in cells
    )
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


def test_too_many_points_are_subsampled_and_counted(monkeypatch):
    rng = np.random.default_rng(0)
    axis_m = 1e-3 * (np.arange(201) - 100)
    full = [
        DepthMap(0.3 + 0.01 * rng.random((201, 201)), np.ones((201, 201)), axis_m, axis_m)
        for _ in range(2)
    ]
    monkeypatch.setattr("clradar.report.page.comparison_figure", comparison_figure)
    page = page_of(*full)
    assert len(page) < PAGE_BYTES
    assert page.count(f"{MAX_POINTS // 2} of {201 * 201} points") == 2
    for cloud, image in zip(clouds(full), full, strict=True):
        there = {tuple(p) for p in (1e3 * image.points_m()).astype(np.float32)}
        kept = {tuple(p) for p in cloud.points_mm}
        assert len(kept) == MAX_POINTS // 2
        assert kept <= there
    # The large image gets the points that the small one leaves.
    small, large = clouds([ball(), full[0]], most=20_000)
    assert len(small.points_mm) == small.total
    assert len(large.points_mm) == 20_000 - small.total
    assert [len(c.points_mm) for c in clouds([full[0]] * 3, most=10)] == [3, 3, 3]


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
            assert float(cell.replace("\N{MINUS SIGN}", "-")) == pytest.approx(
                text.scale * getattr(m, text.field), abs=0.5 * 10**-text.digits
            )
    # The nearer ball is better in all of them.
    assert read.inside["strong"] == values[: len(METRIC_TABLE)]
    assert list(METRICS) == [m.field for m in METRIC_TABLE]
    assert METRIC_TABLE[0].field == METRICS[0]
    assert len(read.inside["dd"]) == len(METRIC_TABLE)


def test_an_undefined_metric_has_its_reason():
    read = Read(page_of(ball(-0.03), ball(0.03)))
    assert "n/a" in read.inside["td"]
    assert sum("no pixel in common" in text for text in read.inside["dd"]) == 1
    assert "no pixel in common" not in page_of(ball(), ball())


def test_settings_are_rows_of_names_and_values():
    meta = {"a": {"b": [1, 2.5]}, "c": True, "d": None, "e": [], "f": [{"g": 1}, 3]}
    read = Read(settings_table(meta))
    names, values = read.inside["th"], read.inside["td"]
    assert dict(zip(names, values, strict=True)) == {
        "a.b": "1, 2.5",
        "c": "yes",
        "d": "\N{EN DASH}",
        "e": "none",
        "f[0].g": "1",
        "f[1]": "3",
    }


def test_enormous_settings_are_cut_visibly():
    deep: dict[str, Any] = {}
    for _ in range(200):
        deep = {"k": deep}
    table = settings_table({"deep": deep, "long": "y" * 10_000})
    assert "nested deeper" in table
    assert "(9600 more characters)" in table
    assert len(table) < 2000
    many = settings_table({str(i): i for i in range(1000)})
    assert "800 more rows are omitted" in many


def test_errors():
    with pytest.raises(CompareError, match="at least one simulated"):
        page_of(ball())
    with pytest.raises(CompareError, match="metrics for 1 simulated images, got 0"):
        page_of(ball(), ball(), metrics=[])
    with pytest.raises(CompareError, match="same pixels"):
        page_of(ball(), ball(n=51))
    full = ball()
    empty = DepthMap(full.depth_m, 0 * full.amplitude, full.x_m, full.y_m)
    with pytest.raises(CompareError, match="image 'image 1': expected an amplitude above 0"):
        page_of(full, empty)
    with pytest.raises(ModelError, match="dynamic_range_db"):
        page_of(ball(), ball(), dynamic_range_db=0)


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
    assert read.inside["summary"] == ["Measurement", name.removesuffix(".h5"), "This comparison"]
    cells = read.inside["td"]
    for expected in ("measured.h5", name, "41", "</script>", "compare", "fast"):
        assert expected in cells
    digest = hashlib.sha256(Path("measured.h5").read_bytes()).hexdigest()
    assert digest in cells
    assert any("within 20 dB" in cell for cell in cells)

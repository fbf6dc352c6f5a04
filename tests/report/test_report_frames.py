"""The time line of the HTML report: its bytes, and slider, chart and 3-D view in a browser."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterator
from typing import Any

import chromium
import numpy as np
import pytest
from test_report import Read, ball

from clradar import compare
from clradar.errors import CompareError
from clradar.model import DepthMap
from clradar.report import FrameSeries, frames_report
from clradar.report import frames as frames_module
from clradar.report.frames import frame_data
from clradar.report.tables import METRIC_TEXTS

SHIFTS_M = (0.0, 2e-3, 8e-3, 4e-3)
"""Of the simulated ball along x; the measured one moves up by 10 mm from frame to frame."""


def images(i: int) -> list[DepthMap]:
    return [ball(0, 0.01 * i), ball(SHIFTS_M[i], 0.01 * i), ball(0, 0.01 * i, 0.302)]


def series() -> FrameSeries:
    found = FrameSeries(["measured", "shifted", "behind"])
    for i in range(len(SHIFTS_M)):
        found.add(f"frame {10 * i}", images(i))
    return found


def unpacked(data: dict[str, Any], image: int) -> np.ndarray:
    """Levels and depths of an image, shape (frames, 2, rows, columns), uint8."""
    codes = np.frombuffer(zlib.decompress(base64.b64decode(data["codes"][image])), np.uint8)
    return codes.reshape(len(data["names"]), 2, *data["counts"][::-1])


def test_the_page_has_the_pixels_and_metrics_of_every_frame() -> None:
    data = Read(frames_report(series())).data()["frames"]
    assert data["names"] == ["frame 0", "frame 10", "frame 20", "frame 30"]
    for i in range(len(SHIFTS_M)):
        for j, image in enumerate(images(i)):
            level, depth = unpacked(data, j)[i].astype(float)
            rows, columns = np.nonzero(image.mask)
            at = np.round((1e3 * image.y_m[rows] - data["first"][1]) / data["step"][1]).astype(int)
            along = np.round((1e3 * image.x_m[columns] - data["first"][0]) / data["step"][0])
            place = (at, along.astype(int))
            assert np.count_nonzero(level) == len(rows)
            expected_db = 20 * np.log10(image.amplitude[image.mask] / image.amplitude.max())
            range_db = image.dynamic_range_db
            found_db = -range_db * (1 - (level[place] - 1) / 254)
            assert np.abs(found_db - expected_db).max() <= range_db / 254 / 2 + 1e-3
            low, high = data["depth"]
            depth_mm = low + (depth[place] - 1) / 254 * (high - low)
            error_mm = np.abs(depth_mm - 1e3 * image.depth_m[image.mask])
            assert error_mm.max() <= (high - low) / 254 / 2 + 1e-3
    every = [images(i) for i in range(len(SHIFTS_M))]
    for text, shown in zip(METRIC_TEXTS, data["metrics"], strict=True):
        expected = [
            [text.scale * getattr(compare(one[0], one[j]), text.field) for one in every]
            for j in (1, 2)
        ]
        assert np.allclose(shown["values"], expected)


def test_a_frame_without_an_image_is_a_gap() -> None:
    empty = DepthMap(np.full((61, 61), np.nan), np.zeros((61, 61)), ball().x_m, ball().y_m)
    found = FrameSeries(["a", "b"])
    found.add("0", [empty, ball()])
    found.add("1", [ball(), ball(2e-3)])
    data = frame_data(found)
    assert [metric["values"][0][0] for metric in data["metrics"]] == [None] * len(METRIC_TEXTS)
    assert not unpacked(data, 0)[0].any()
    assert found.mean(0, "overlap") == compare(ball(), ball(2e-3)).overlap
    nothing = FrameSeries(["a", "b"])
    nothing.add("0", [empty, empty])
    with pytest.raises(CompareError, match="above zero, got none"):
        frames_report(nothing)


def test_pages_stay_small(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = frame_data(series())
    most = sum(len(base64.b64decode(codes)) for codes in whole["codes"]) // 2
    monkeypatch.setattr(frames_module, "MAX_PACKED_BYTES", most)
    small = frame_data(series())
    assert sum(len(base64.b64decode(codes)) for codes in small["codes"]) <= most
    assert small["factor"] > 1
    # What is highest stays, at its place, with its depth.
    for j in range(3):
        for i in range(4):
            places, depths = [], []
            for data in (whole, small):
                level, depth = unpacked(data, j)[i]
                at = np.unravel_index(level.argmax(), level.shape)
                assert level[at] == 255
                places.append(np.array(data["first"]) + np.array(at[::-1]) * data["step"])
                depths.append(int(depth[at]))
            assert depths[0] == depths[1]
            assert (np.abs(places[1] - places[0]) <= np.array(small["step"]) / 2).all()
    monkeypatch.setattr(frames_module, "MAX_FRAMES", 3)
    with pytest.raises(CompareError, match="at most 3 frames"):
        series()


def test_wrong_frames_are_errors() -> None:
    found = series()
    with pytest.raises(CompareError, match="3 images, got 2"):
        found.add("x", [ball(), ball()])
    with pytest.raises(CompareError, match="frames before"):
        found.add("x", [ball(n=51)] * 3)
    with pytest.raises(CompareError, match="labels"):
        FrameSeries(["a"])


needs_browser = pytest.mark.skipif(
    chromium.installed() is None, reason="no Chromium here: install Debian's chromium package"
)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[chromium.Page]:
    path = tmp_path_factory.mktemp("page") / "frames.html"
    path.write_text(frames_report(series()), encoding="utf-8")
    with chromium.chromium(tmp_path_factory.mktemp("profile")) as tab:
        tab.prefer("light")
        tab.resize(1000, 2400)  # all of it on the screen
        tab.open(path)
        tab.js(
            "new Promise(done => { const c = document.getElementById('frames'); const look = () =>"
            " c.dataset.ready ? done() : requestAnimationFrame(look); look(); })"
        )
        tab.settle()
        # Now, since reading pixels back, as tests do, is something that Chromium complains of.
        assert tab.complaints() == []
        assert all(address.startswith(("file:", "data:", "blob:")) for address in tab.requests())
        yield tab


def show(page: chromium.Page, frame: int) -> None:
    page.js(
        "(() => { const s = document.getElementById('frame');"
        f" s.value = {frame}; s.dispatchEvent(new Event('input')); }})()"
    )
    page.settle()


def height_of_ball(page: chromium.Page) -> float:
    """How far up the measured ball is, as a share of its picture."""
    found = page.js(
        "(() => { const c = document.getElementById('frames');"
        " const d = c.getContext('2d').getImageData(0, 26, 200, 300).data; let [n, y] = [0, 0];"
        " for (let i = 0; i < d.length; i += 4) if (d[i] > 150 && d[i + 2] < 100)"
        " { n++; y += Math.floor(i / 4 / 200); } return n ? 1 - y / n / 300 : -1; })()"
    )
    return float(found)


@needs_browser
def test_slider_and_keys_go_through_the_frames(page: chromium.Page) -> None:
    show(page, 0)
    heights = [height_of_ball(page)]
    page.js("document.getElementById('frame').focus()")
    for _ in range(3):
        page.key("ArrowRight")
        heights.append(height_of_ball(page))
    assert page.js("document.getElementById('frame-name').textContent") == "frame 30"
    # The pictures show the box around all frames: 24 mm of ball and three steps of 10 mm.
    assert np.diff(heights) == pytest.approx(3 * [10 / 54], abs=0.03)


@needs_browser
def test_the_3d_view_follows(page: chromium.Page) -> None:
    shots = []
    for frame in (0, 3):
        show(page, frame)
        shots.append(page.js("document.getElementById('view').toDataURL()"))
        counts = page.js("[...document.querySelectorAll('.count')].map(c => c.textContent)")
        expected = [f"{int(image.mask.sum())} points" for image in images(frame)]
        assert counts == expected
    assert shots[0] != shots[1]


@needs_browser
def test_the_chart_shows_values_and_chooses_frames(page: chromium.Page) -> None:
    show(page, 0)
    box = page.js(
        "(() => { const r = document.getElementById('chart').getBoundingClientRect();"
        " return [r.left, r.top, r.width, r.height]; })()"
    )
    x = box[0] + 44 + (box[2] - 52) * 2.5 / 4  # the middle of the third of four
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, x, box[1] + 50, button="left", clickCount=1)
    page.settle()
    assert page.js("document.getElementById('frame-name').textContent") == "frame 20"
    expected = compare(*images(2)[:2])
    for name, digits, scale in (("overlap", 3, 1.0), ("depth_rmse_m", 2, 1e3)):
        index = [text.field for text in METRIC_TEXTS].index(name)
        page.js(
            "(() => { const m = document.getElementById('metric');"
            f" m.value = {json.dumps(str(index))}; m.dispatchEvent(new Event('change')); }})()"
        )
        shown = page.js("document.querySelector('#values li').textContent")
        assert shown.strip() == f"shifted: {scale * getattr(expected, name):.{digits}f}"


@needs_browser
def test_it_plays(page: chromium.Page) -> None:
    show(page, 0)
    page.js(
        "new Promise(done => { const seen = new Set(); const name ="
        " document.getElementById('frame-name'); const look = new MutationObserver(() => {"
        " seen.add(name.textContent); if (seen.size === 4) { look.disconnect(); done(); } });"
        " look.observe(name, {childList: true}); document.getElementById('play').click(); })"
    )
    page.js("document.getElementById('play').click()")
    assert page.js("document.getElementById('play').textContent") == "Play"

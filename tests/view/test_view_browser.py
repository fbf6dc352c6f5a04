"""The live view in a browser: pixels, keys, reloading, two at once, nothing from elsewhere."""

from __future__ import annotations

import contextlib
import signal
import threading
from pathlib import Path

import chromium
import numpy as np
import pytest
from view_tab import SIZE, Tab, in_browser, running_script, viewing

import clradar
from calibration import CornerReflector, response
from clradar.view.server import serving
from clradar.view.session import View
from clradar.view.sources import FixedFrames
from clradar.view.wish import Wish
from measurement_io import save_capture, save_recording

pytest.importorskip("viser")

PLACE = (
    "[...document.querySelectorAll('input')].filter(one => one.inputMode === 'decimal')"
    ".slice(-3).map(one => Number(one.value))"
)
"""The three numbers of the place, millimetres."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of a small corner reflector, to the left and in the middle."""
    folder = tmp_path_factory.mktemp("recording") / "corner/30"
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 16)
    captures = [
        clradar.Capture(
            response(CornerReflector((x_m, 0.0, 0.3)), array, waveform), array, waveform
        )
        for x_m in (0.03, 0.0)
    ]
    save_recording(folder, captures, timestamps_us=[0, 125_000])
    save_capture(folder.parent / "middle.h5", captures[1])
    return folder


@in_browser
def test_frames_keys_reload_two_browsers_and_the_end(recording: Path, tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        options = ("--simulated", recording.parent / "middle.h5")
        process, address = stack.enter_context(viewing("view", recording, *options))
        page = stack.enter_context(chromium.chromium(tmp_path / "one", webgl=True))
        tab = Tab(page, address)
        tab.load(" simulated")
        tab.says("dB correlation")
        for _ in range(2):  # pictures and points, pictures alone, points alone
            page.key("l", "KeyL")
        # The larger x is to the left.
        left = tab.lit(lambda m, s: len(m) > 50 and len(s) > 50 and m.mean() < s.mean() - 25)
        tab.click((SIZE[0] - 350) / 2, SIZE[1] / 2)  # the simulated point, beside the panel
        tab.until(f"Math.abs({PLACE}[0]) < 3")
        page.key("b", "KeyB")
        tab.lit(lambda m, s: len(m) > 50 and len(s) == 0)
        page.key("b", "KeyB")
        tab.lit(lambda m, s: len(m) == 0 and len(s) > 50)
        page.key("b", "KeyB")
        tab.lit(lambda m, s: len(m) > 50 and len(s) > 50)
        page.key("b", "KeyB")
        page.js("document.activeElement.blur()")
        page.key("n", "KeyN")
        tab.says("frame 1: image of")
        # It has moved to the right: the key did not turn the camera, which shows it in the middle.
        tab.lit(lambda m, s: len(m) > 50 and m.mean() > left.mean() + 25)
        page.key("v", "KeyV")
        tab.says("voxels drawn")

        # A browser that comes later, or again, sees the same.
        tab.load("voxels drawn")
        tab.lit(lambda m, s: len(m) > 50 and m.mean() > left.mean() + 25)
        other = Tab(stack.enter_context(chromium.chromium(tmp_path / "two", webgl=True)), address)
        other.load("frame 1: image of")
        other.page.key("p", "KeyP")
        other.says("frame 0: image of")
        tab.says("frame 0: image of")
        other.page.key(" ", "Space")  # plays
        for frame in (1, 0, 1):
            tab.says(f"frame {frame}: image of")
        asked = [*page.requests(), *other.page.requests()]
        assert asked
        assert [url for url in asked if not url.startswith((address, "data:", "blob:"))] == []

        process.send_signal(signal.SIGINT)
        assert process.communicate()[1] == ""
        assert process.returncode == 0
        assert "errorText" in page.call("Page.navigate", url=address)


def test_a_server_that_stops_leaves_no_thread() -> None:
    before = set(threading.enumerate())
    grid = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (4, 3, 2))
    source = FixedFrames("ones", ("ones",), lambda _: clradar.Volume(np.ones(grid.shape), grid))
    with serving(View(source=source, wish=Wish()), 0) as (_, session):
        session.settle()
        assert set(threading.enumerate()) > before
    for thread in set(threading.enumerate()) - before:
        thread.join()


@in_browser
def test_an_iterable_is_shown_newest_first(tmp_path: Path) -> None:
    """Ten lines of a lab: a generator that ends with an error once its frames were seen."""
    script, seen = tmp_path / "lab.py", tmp_path / "seen"
    script.write_text(
        "import pathlib, clradar, clradar.view\n"
        "array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 8)\n"
        "def frames():\n"
        f"    while not pathlib.Path({str(seen)!r}).exists():\n"
        "        yield clradar.room_capture(array, waveform, [], points_m=[[0, 0, 0.3]])\n"
        "    raise RuntimeError('the radar was switched off')\n"
        "clradar.view.show(frames(), title='lab', port=0)\n"
    )
    with (
        running_script(script) as (process, address),
        chromium.chromium(tmp_path / "profile", webgl=True) as page,
    ):
        tab = Tab(page, address)
        tab.load(" shown")
        seen.touch()
        assert "switched off" in process.communicate()[1]
        assert process.returncode == 1

"""How fast frames are imaged: `clradar.FrameImager` beside one `backproject` per frame, and live.

    python benchmarks/live_rate.py [--frames N] [--spacing-mm S] [--tolerance-db T] [--rate-hz R]

Images and depth maps of N frames of a hand-sized cloud of points on the paper's volume, 94 x 94
pairs and 128 frequencies, by both in turns; then N frames through `clradar live`'s own loop from a
sender in another process, at R frames per second. Prints medians of time and of processor time,
their ratio, and rate, latency and dropped frames of the loop.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import clradar
from clradar.live import LiveImages, run
from clradar.live.inbox import Arrived
from clradar.live.screen import state_words
from clradar.live.sources import StreamSource
from measurement_io import save_recording

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)


def frames_of(n: int) -> list[clradar.Capture]:
    rng = np.random.default_rng(0)
    points_m = rng.uniform([-0.07, -0.09, 0.28], [0.07, 0.09, 0.32], (60, 3))
    return [
        clradar.room_capture(ARRAY, WAVEFORM, [], points_m=np.add(points_m, [0, 0, 1e-3 * i]))
        for i in range(n)
    ]


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Time and processor time, seconds."""
    begun_s, busy_s = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begun_s, time.process_time() - busy_s


def compare(frames: list[clradar.Capture], grid: clradar.VoxelGrid, tolerance_db: float) -> None:
    both: dict[str, list[tuple[float, float]]] = {"FrameImager": [], "backproject": []}
    with clradar.FrameImager(ARRAY, WAVEFORM, grid, tolerance_db=tolerance_db) as imager:

        def kept(frame: clradar.Capture) -> clradar.DepthMap:
            imager.form(frame)
            return imager.depth_map()

        def single(frame: clradar.Capture) -> clradar.DepthMap:
            volume = clradar.backproject(frame, grid, tolerance_db=tolerance_db, check_grid=False)
            return volume.depth_map()

        for warm in (kept, single):
            warm(frames[0])
        for frame in frames:
            both["FrameImager"].append(timed(lambda frame=frame: kept(frame)))
            both["backproject"].append(timed(lambda frame=frame: single(frame)))
    medians = {name: np.median(rows, axis=0) for name, rows in both.items()}
    for name, (took_s, busy_s) in medians.items():
        print(f"{name:12s} {1e3 * took_s:6.0f} ms, processor {1e3 * busy_s:6.0f} ms per frame")
    ratios = [b[1] / a[1] for a, b in zip(*both.values(), strict=True)]
    print(f"backproject over FrameImager, processor time: {statistics.median(ratios):.2f}")


def live(frames: list[clradar.Capture], grid: clradar.VoxelGrid, args: argparse.Namespace) -> None:
    source = StreamSource("127.0.0.1", 0)
    images = LiveImages(grid, "rect", args.tolerance_db, 15.0, clradar.open_device())
    images.image(Arrived(frames[0], "", 0.0))
    with tempfile.TemporaryDirectory() as folder:
        radar = save_recording(
            Path(folder) / "points" / "30", frames, timestamps_us=range(len(frames))
        )
        sender = subprocess.Popen(
            [sys.executable, "-m", "clradar", "replay", str(radar), "--to",
             f"127.0.0.1:{source.port}", "--rate-hz", str(args.rate_hz), "--repeat", "1000"],
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        state = run(source, images, lambda shown: None, lambda *_: None, most=3 * len(frames))
        sender.kill()
        sender.wait()
    images.close()
    print(f"live, sender at {args.rate_hz:g} Hz: {state_words(*state)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=9)
    parser.add_argument("--spacing-mm", type=float, default=2.0)
    parser.add_argument("--tolerance-db", type=float, default=-50.0)
    parser.add_argument("--rate-hz", type=float, default=10.0)
    args = parser.parse_args()
    grid = clradar.VoxelGrid.from_extent(
        (-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3 * args.spacing_mm
    )
    print(f"{grid.counts} voxels, {args.tolerance_db:g} dB, {clradar.open_device().info.label}")
    frames = frames_of(args.frames)
    compare(frames, grid, args.tolerance_db)
    live(frames, grid, args)


if __name__ == "__main__":
    main()

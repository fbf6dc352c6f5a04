"""Frames that `clradar view` shows of a folder that is written at a rate, and their latency.

    PYTHONPATH=tests/support python benchmarks/view_rate.py [--rate-hz 10] [--seconds 20] [--mm 2]

A hand of 94 x 94 x 128 samples moves to the side by a voxel per frame; files come by one rename.
A headless Chromium on this machine shows them, with WebGL in software. Prints what the page says
of itself: frames shown, and over the last 30 rate and latency from the last write of a file.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import chromium
import numpy as np
from study import ARRAY, WAVEFORM

import clradar
from clradar.hand import hand_mesh
from clradar.view.server import serving
from clradar.view.sources import open_source
from clradar.view.wish import Wish, grid_mm
from measurement_io import save_capture

SIZE = (1200, 900)
FRAMES = 10

WRITE = """
import os, shutil, sys, time
made, folder, rate_hz, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4])
start_s, n = time.monotonic(), 0
while time.monotonic() - start_s < seconds:
    path = os.path.join(folder, f"{n:06d}.h5")
    shutil.copyfile(os.path.join(made, f"{n % 10}.h5"), path + ".part")
    os.replace(path + ".part", path)
    n += 1
    time.sleep(max(0.0, start_s + n / rate_hz - time.monotonic()))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--mm", type=float, default=2.0, help="voxel size")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as top:
        made, folder = Path(top, "made"), Path(top, "frames")
        made.mkdir()
        folder.mkdir()
        scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=0.5)
        for n in range(FRAMES):
            there = scene.transformed(np.eye(4) + np.eye(4, k=3) * 2e-3 * n)
            save_capture(made / f"{n}.h5", clradar.simulate(there, ARRAY, WAVEFORM, seed=0))
        grid = grid_mm((-100, 100), (-100, 100), (260, 340), given.mm)
        with (
            serving(open_source(folder, watch=True), Wish(frame=-1, grid=grid), port=0) as (
                port,
                _,
            ),
            chromium.chromium(Path(top), webgl=True) as page,
        ):
            page.resize(*SIZE)
            page.open(f"http://127.0.0.1:{port}/")
            options = [str(made), str(folder), str(given.rate_hz), str(given.seconds)]
            with subprocess.Popen([sys.executable, "-c", WRITE, *options]) as writer:
                time.sleep(given.seconds - 1.0)
                said = page.js("document.body.textContent.match(/[0-9]+ shown[^]*?dropped/)[0]")
                print(f"{said}, load {os.getloadavg()[0]:.1f}")
                writer.wait()


if __name__ == "__main__":
    main()

"""Frames that `clradar view` shows of a folder that is written at a rate, and their latency.

    PYTHONPATH=tests/support python benchmarks/view_rate.py [--rate-hz 10] [--seconds 20]

A hand of 94 x 94 x 128 samples moves to the side by a voxel of 2 mm per frame; files come by one
rename. A headless Chromium on this machine shows them, with WebGL in software. Prints what the page
says of itself: over the last 30 frames rate, and latency from the last write of a file.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path

import chromium
import numpy as np
from study import ARRAY, WAVEFORM

import clradar
from clradar.hand import hand_mesh
from clradar.view.server import serving
from clradar.view.session import View
from clradar.view.sources import open_source
from clradar.view.wish import Wish, grid_mm
from measurement_io import save_capture

SIZE = (1200, 900)
FRAMES = 10


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as top:
        made, folder = Path(top, "made"), Path(top, "frames")
        made.mkdir()
        folder.mkdir()
        scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=0.5)
        for n in range(FRAMES):
            there = scene.transformed(np.eye(4) + np.eye(4, k=3) * 2e-3 * n)
            save_capture(made / f"{n}.h5", clradar.simulate(there, ARRAY, WAVEFORM, seed=0))
        grid = grid_mm((-100, 100), (-100, 100), (260, 340), 2.0)
        view = View(source=open_source(folder, watch=True), wish=Wish(frame=-1, grid=grid))
        with (
            serving(view, port=0) as (port, _),
            chromium.chromium(Path(top), webgl=True) as page,
        ):
            page.resize(*SIZE)
            page.open(f"http://127.0.0.1:{port}/")
            start_s = time.monotonic()
            for n in range(round(given.seconds * given.rate_hz)):
                part = Path(shutil.copyfile(made / f"{n % FRAMES}.h5", folder / f"{n:06d}.part"))
                os.replace(part, part.with_suffix(".h5"))
                time.sleep(max(0.0, start_s + (n + 1) / given.rate_hz - time.monotonic()))
            print(page.js("document.body.textContent.match(/[0-9]+ shown[^]*?dropped/)[0]"))


if __name__ == "__main__":
    main()

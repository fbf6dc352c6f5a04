"""How fast the live view plays: frames that a headless Chromium on this machine draws per second.

Ten frames of a simulated hand, 101 x 101 x 41 voxels of 2 mm, from memory, with projection, depth
map, slices and points or voxels of each; WebGL is in software. Reading and imaging are not timed.

    PYTHONPATH=tests/support python benchmarks/view_rate.py [--frames 60]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import chromium
import numpy as np

import clradar
from clradar.hand import hand_mesh
from clradar.view.playing import Player
from clradar.view.server import serving
from clradar.view.sources import FixedFrames
from clradar.view.wish import Wish

FRAMES = 10
SIZE = (1200, 900)
MOST_PER_S = 30.0

COUNT = """
new Promise(done => {
  let shown = '', changes = -1, start = 0;
  const look = now => {
    const frame = document.body.textContent.match(/frame [0-9]+: volume/);
    if (frame && frame[0] !== shown) {
      shown = frame[0]; changes += 1;
      if (changes === 0) start = now;
      if (changes === WANTED) return done(1000 * changes / (now - start));
    }
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})
"""
"""Frames per second from animation frame to animation frame: a drawn frame that is not new is not
counted."""


def volumes() -> list[clradar.Volume]:
    """A hand that moves to the side by a voxel per frame."""
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 2e-3)
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=0.5)
    capture = clradar.simulate(scene, clradar.arrays.qar50(), waveform, seed=0)
    first = clradar.backproject(capture, grid)
    return [clradar.Volume(np.roll(first.data, i, axis=2), grid) for i in range(FRAMES)]


def processor_s() -> float:
    """Processor time of this process and of all that it started, which the browser's are."""
    used: dict[int, tuple[int, float]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        ticks = int(fields[11]) + int(fields[12])
        used[int(folder.name)] = int(fields[1]), ticks / os.sysconf("SC_CLK_TCK")
    ours = {os.getpid()}
    while more := {pid for pid, (parent, _) in used.items() if parent in ours} - ours:
        ours |= more
    return sum(used[pid][1] for pid in ours)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="that are counted, of each kind")
    wanted = parser.parse_args().frames
    contents = volumes()
    labels = tuple(f"frame {i}" for i in range(FRAMES))
    source = FixedFrames("hand", labels, contents.__getitem__)
    with (
        serving(source, Wish(dynamic_range_db=20.0), port=0) as (port, session),
        tempfile.TemporaryDirectory() as folder,
        chromium.chromium(Path(folder), webgl=True) as page,
    ):
        page.resize(*SIZE)
        page.open(f"http://127.0.0.1:{port}/")
        player = Player(session, MOST_PER_S)
        for voxels in (False, True):
            session.change(voxels=voxels)
            session.settle()
            player.play(True)
            page.js(COUNT.replace("WANTED", "10"))
            before_s = processor_s()
            per_s = page.js(COUNT.replace("WANTED", str(wanted)))
            used_ms = 1e3 * (processor_s() - before_s) / wanted
            player.play(False)
            session.settle()
            print(
                f"{'voxels' if voxels else 'points'}: {per_s:.1f} frames/s, {used_ms:.0f} ms of "
                f"processor time for each in server and browser, load {os.getloadavg()[0]:.1f}"
            )
        session.close()
        player.close()


if __name__ == "__main__":
    main()

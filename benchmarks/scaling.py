"""Time of each piece against its amount of work: samples, paths, faces, rays, voxels, pairs.

    .venv/bin/python benchmarks/scaling.py [--device NAME] [--figure docs/images/scaling.png]

For every piece a few sizes, in turn, the median of REPEATS each after a first run that compiles.
Prints the points, writes them to ``benchmarks/scaling.json``, and draws a figure with the exponent
that joins the first and the last point of each curve.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import clradar
from clradar.bench import meshes
from clradar.bench.images import noise
from clradar.bench.nearest import NearestHits
from clradar.bench.phasor_sums import PathSums
from clradar.bench.rays import bounces_of, our_tree, surface_of
from clradar.bench.timing import ARRAY, WAVEFORM, interleaved_s
from clradar.hand import hand_mesh

REPEATS = 3
PIECES = {
    "simulate a hand": "samples",
    "phasor sum": "paths",
    "tree": "faces",
    "visibility of 16 384 points, 94 Tx": "faces",
    "300 000 bounce rays": "faces",
    "image, fast": "voxels",
    "image, range": "voxels",
    "image, exact": "voxels",
    "image, fast, 132 000 voxels": "pairs of antennas",
}
Works = list[tuple[int, Callable[[], Any]]]
"""Amount of work, and how to do it."""


def _simulations(device: clradar.Device) -> Works:
    scene = clradar.Scene.from_mesh(hand_mesh("F", device=device), alpha=0.5)
    works: Works = []
    for per_mm2 in (0.1, 0.4, 1.6, 6.4):
        run = partial(
            clradar.simulate, scene, ARRAY, WAVEFORM, samples_per_mm2=per_mm2, device=device
        )
        works.append((int(run().meta["rays"]["samples"]), run))
    return works


def _phasors(device: clradar.Device) -> Works:
    sizes = (20_000, 200_000, 2_000_000, 8_000_000)
    return [(n, PathSums(device, n).ours) for n in sizes]


def _trees(device: clradar.Device) -> Works:
    scenes = [meshes.waves(cells) for cells in (22, 71, 224, 708)]
    return [(s.n_faces, partial(our_tree, s.triangles_m, device)) for s in scenes]


def _images(device: clradar.Device, method: str, sides: tuple[int, ...]) -> Works:
    capture = noise()
    works: Works = []
    for side in sides:
        grid = clradar.VoxelGrid(
            np.array([-0.5e-3 * side, -0.5e-3 * side, 0.26]), np.full(3, 1e-3), (side, side, 41)
        )
        run = partial(clradar.backproject, capture, grid, method=method, device=device)
        works.append((int(np.prod(grid.counts)), run))
    return works


def _arrays(device: clradar.Device) -> Works:
    grid = clradar.VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.3, 0.308), 1e-3)
    whole = noise()
    works: Works = []
    for step in (8, 4, 2, 1):
        array = clradar.AntennaArray(ARRAY.tx_m[::step], ARRAY.rx_m[::step])
        capture = clradar.Capture(whole.data[::step, ::step], array, WAVEFORM)
        works.append(
            (array.n_tx * array.n_rx, partial(clradar.backproject, capture, grid, device=device))
        )
    return works


def measure(device: clradar.Device) -> list[dict[str, Any]]:
    """Return the points of every piece."""
    rows: list[dict[str, Any]] = []

    def add(piece: str, works: Works) -> None:
        times_s = np.median(interleaved_s([run for _, run in works], REPEATS), axis=0)
        for (amount, _), seconds in zip(works, times_s, strict=True):
            row = {"piece": piece, "work": PIECES[piece], "amount": amount, "s": float(seconds)}
            rows.append(row)
            print(f"{piece}: {amount} {PIECES[piece]}, {seconds:.4f} s", flush=True)

    add("simulate a hand", _simulations(device))
    add("phasor sum", _phasors(device))
    add("tree", _trees(device))
    for cells in (22, 71, 224, 708):
        scene = meshes.waves(cells)
        with surface_of(scene, 16384, device) as surface:
            seen = partial(surface.visible_bits, ARRAY.tx_m)
            add("visibility of 16 384 points, 94 Tx", [(scene.n_faces, seen)])
        with NearestHits(scene.triangles_m, *bounces_of(scene, 300_000), device) as rays:
            add("300 000 bounce rays", [(scene.n_faces, rays.trace)])
    add("image, fast", _images(device, "fast", (10, 32, 100, 316)))
    add("image, range", _images(device, "range", (10, 32, 64)))
    add("image, exact", _images(device, "exact", (4, 8, 16)))
    add("image, fast, 132 000 voxels", _arrays(device))
    return rows


def draw(rows: list[dict[str, Any]], label: str, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    panels = (("samples", "paths"), ("faces",), ("voxels",), ("pairs of antennas",))
    figure, axes = plt.subplots(1, 4, figsize=(12, 4.6), layout="constrained", sharey=True)
    for axis, kinds in zip(axes, panels, strict=True):
        for piece, kind in PIECES.items():
            if kind not in kinds:
                continue
            points = sorted((r["amount"], r["s"]) for r in rows if r["piece"] == piece)
            amount, seconds = np.array(points).T
            exponent = np.log(seconds[-1] / seconds[0]) / np.log(amount[-1] / amount[0])
            axis.loglog(amount, seconds, "o-", markersize=4, label=f"{piece}: {exponent:.2f}")
        axis.set(xlabel=" or ".join(kinds))
        axis.grid(alpha=0.3, which="major")
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    bottom, top = axes[0].get_ylim()
    for axis in axes:
        low, high = axis.get_xlim()
        for start in np.geomspace(bottom * 1e-4, top, 9):
            axis.loglog(
                [low, high], [start, start * high / low], ":", color="0.8", linewidth=1, zorder=0
            )
        axis.set(xlim=(low, high))
    axes[0].set(ylabel="time, s", ylim=(bottom, top))
    figure.suptitle(
        f"{label}; dotted: proportional to the work; numbers: exponent from end to end", fontsize=10
    )
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default=None)
    parser.add_argument("--figure", type=Path, default=None)
    parser.add_argument("--redraw", action="store_true", help="from scaling.json, no new run")
    given = parser.parse_args()
    record = Path(__file__).with_name("scaling.json")
    if given.redraw:
        result = json.loads(record.read_text(encoding="utf-8"))
    else:
        device = clradar.open_device(given.device)
        result = {"device": device.info.label, "rows": measure(device)}
        record.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if given.figure is not None:
        draw(result["rows"], result["device"], given.figure)


if __name__ == "__main__":
    main()

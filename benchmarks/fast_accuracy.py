"""Error of `method="fast"` over drawn arrays, waveforms, grids and tolerances.

    .venv/bin/python benchmarks/fast_accuracy.py [--cases 200] [--seed 0] [--width 1]

Every case is drawn from its own number, so that one that fails can be run again (`--only N`).
Error: RMS over random voxels of the difference to the exact sum, in float64, relative to the RMS of
the exact image over the same voxels; and the same for the corners of the grid alone. Prints the
cases beyond their tolerance, then the worst and typical margins.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import clradar
from clradar import AntennaArray, Capture, VoxelGrid, Waveform
from clradar.imaging import block_tree, fast

C_M_PER_S = 299_792_458.0
N_VOXELS = 400
MOST_VOXELS = 60_000
QAR50 = clradar.arrays.qar50()
Rng = np.random.Generator


def exact(capture: Capture, at_m: np.ndarray) -> np.ndarray:
    """The image at some points, in float64: one bilinear form per frequency."""
    tx_m, rx_m = capture.array.tx_m, capture.array.rx_m
    tx_d, rx_d = (np.linalg.norm(at_m[:, None] - a, axis=-1) for a in (tx_m, rx_m))
    total = np.zeros(len(at_m), complex)
    for m, f in enumerate(capture.waveform.frequencies_hz):
        t, r = (np.exp(2j * np.pi * f / C_M_PER_S * d) for d in (tx_d, rx_d))
        total += np.einsum(
            "vt,tr,vr->v", t, capture.data[:, :, m].astype(complex), r, optimize=True
        )
    return total / capture.data.size


def echoes(array: AntennaArray, waveform: Waveform, at_m: np.ndarray, rng: Rng) -> Capture:
    """What the array records of point scatterers of random strength."""
    strength = rng.normal(size=len(at_m)) + 1j * rng.normal(size=len(at_m))
    tx_d, rx_d = (np.linalg.norm(at_m[:, None] - a, axis=-1) for a in (array.tx_m, array.rx_m))
    data = np.empty((array.n_tx, array.n_rx, waveform.n_freq), np.complex64)
    for m, f in enumerate(waveform.frequencies_hz):
        t, r = (np.exp(-2j * np.pi * f / C_M_PER_S * d) for d in (tx_d, rx_d))
        data[:, :, m] = (t * strength[:, None]).T @ r
    return Capture(data, array, waveform)


def noise(array: AntennaArray, waveform: Waveform, at_m: np.ndarray, rng: Rng) -> Capture:
    re, im = rng.normal(size=(2, array.n_tx, array.n_rx, waveform.n_freq)).astype(np.float32)
    return Capture(re + 1j * im, array, waveform)


# Arrays -------------------------------------------------------------------------------------------


def _qar50(rng: Rng) -> AntennaArray:
    return QAR50


def _clusters(rng: Rng) -> AntennaArray:
    def side() -> np.ndarray:
        centres = rng.uniform(-0.08, 0.08, (rng.integers(1, 7), 3)) * [1, 1, 0.1]
        n = int(rng.integers(1, 90))
        return centres[rng.integers(0, len(centres), n)] + rng.normal(0, 0.006, (n, 3)) * [
            1,
            1,
            0.2,
        ]

    return AntennaArray(side(), side())


def _line(rng: Rng) -> AntennaArray:
    x = np.linspace(-0.1, 0.1, int(rng.integers(2, 120)))
    line = np.stack([x, 0 * x, 0 * x], axis=1)
    crossed, beside = line[:, [1, 0, 2]], line + np.array([0, 0.01, 0])
    return AntennaArray(line, crossed if rng.random() < 0.5 else beside)


def _ring(rng: Rng) -> AntennaArray:
    turn = np.linspace(0, 2 * np.pi, int(rng.integers(8, 120)), endpoint=False)
    ring = 0.08 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    return AntennaArray(ring, ring[1::2] if rng.random() < 0.5 else 0.5 * ring)


def _in_space(rng: Rng) -> AntennaArray:
    n, m = rng.integers(1, 90, 2)
    size = rng.uniform(0.02, 0.3)
    return AntennaArray(rng.uniform(-size, size, (n, 3)), rng.uniform(-size, size, (m, 3)))


def _filled(rng: Rng) -> AntennaArray:
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-0.06, 0.06, 12)] * 2))
    side = np.stack([x, y, 0 * x], axis=1)
    return AntennaArray(side, side[rng.permutation(len(side))[:20]])


ARRAYS: dict[str, Callable[[Rng], AntennaArray]] = {
    "qar50": _qar50, "clusters": _clusters, "line": _line, "ring": _ring, "in space": _in_space,
    "filled": _filled,
}  # fmt: skip

# Waveforms ----------------------------------------------------------------------------------------


def _sweep(rng: Rng) -> Waveform:
    return Waveform.sfcw(72e9, 82e9, int(rng.integers(2, 129)))


def _wide(rng: Rng) -> Waveform:
    return Waveform.sfcw(rng.uniform(2e9, 30e9), rng.uniform(50e9, 90e9), int(rng.integers(2, 129)))


def _narrow(rng: Rng) -> Waveform:
    start = rng.uniform(1e9, 300e9)
    return Waveform.sfcw(start, start * 1.003, int(rng.integers(2, 40)))


def _unequal(rng: Rng) -> Waveform:
    return Waveform(np.sort(rng.uniform(60e9, 84e9, int(rng.integers(2, 100)))))


def _bands(rng: Rng) -> Waveform:
    low, high = np.linspace(24e9, 25e9, 20), np.linspace(76e9, 81e9, 40)
    return Waveform(np.concatenate([low, high]))


def _one(rng: Rng) -> Waveform:
    return Waveform([rng.uniform(1e9, 300e9)])


WAVEFORMS: dict[str, Callable[[Rng], Waveform]] = {
    "sweep": _sweep, "wide": _wide, "narrow": _narrow, "unequal": _unequal, "two bands": _bands,
    "one": _one,
}  # fmt: skip

# Grids --------------------------------------------------------------------------------------------


def _box(rng: Rng, centre: Any, size: Any, step: Any) -> VoxelGrid:
    """A grid of about that size, coarser where it would have too many voxels."""
    size, step = np.broadcast_to(size, 3).astype(float), np.broadcast_to(step, 3).astype(float)
    while (counts := np.floor(size / step).astype(int) + 1).prod() > MOST_VOXELS:
        step = step * np.where(size > 0, 1.2, 1.0)
    origin = np.asarray(centre, float) - 0.5 * step * (counts - 1)
    return VoxelGrid(origin, step, (int(counts[0]), int(counts[1]), int(counts[2])))


def _paper(rng: Rng) -> VoxelGrid:
    return _box(rng, (0, 0, 0.3), (0.2, 0.2, 0.08), 1e-3)


def _near(rng: Rng) -> VoxelGrid:
    depth = rng.uniform(0.0, 0.06)
    return _box(rng, (0, 0, 0.03 + depth / 2), (0.2, 0.2, depth), 2e-3)


def _touching(rng: Rng) -> VoxelGrid:
    """Through the antennas themselves."""
    return _box(rng, (0.0, 0.0, 0.0), (0.16, 0.16, 0.05), 2e-3)


def _edge(rng: Rng) -> VoxelGrid:
    return _box(rng, (0.07, 0.07, 0.06), (0.06, 0.06, 0.08), 1e-3)


def _off_axis(rng: Rng) -> VoxelGrid:
    centre = rng.uniform(-0.8, 0.8, 3) * [1, 1, 0.3] + [0, 0, 0.3]
    return _box(rng, centre, rng.uniform(0.02, 0.2, 3), 1.5e-3)


def _far(rng: Rng) -> VoxelGrid:
    return _box(rng, (0.1, 0, 2.0), (0.6, 0.6, 0.3), 5e-3)


def _very_far(rng: Rng) -> VoxelGrid:
    return _box(rng, (5.0, 0, 20.0), (2.0, 2.0, 1.0), 2e-2)


def _huge(rng: Rng) -> VoxelGrid:
    """Many wavelengths from voxel to voxel."""
    return _box(rng, rng.uniform(-9, 9, 3), rng.uniform(0, 20, 3), rng.uniform(0.01, 1))


def _deep(rng: Rng) -> VoxelGrid:
    return _box(rng, (0, 0, 0.55), (0.3, 0.3, 1.0), 2e-3)


def _tiny(rng: Rng) -> VoxelGrid:
    counts = rng.integers(1, 5, 3)
    counts = (int(counts[0]), int(counts[1]), int(counts[2]))
    origin = rng.uniform((-0.1, -0.1, 0.15), (0.1, 0.1, 0.35))
    return VoxelGrid(origin, rng.uniform(1e-4, 0.02, 3), counts)


def _thin(rng: Rng) -> VoxelGrid:
    size = np.array([0.2, 0.2, 0.2])
    size[rng.integers(0, 3)] = 0.0
    return _box(rng, (0, 0, rng.uniform(0.12, 0.4)), size, 1e-3)


def _uneven(rng: Rng) -> VoxelGrid:
    return _box(rng, (0, 0, 0.3), (0.15, 0.15, 0.1), rng.uniform(0.2e-3, 8e-3, 3))


def _fine(rng: Rng) -> VoxelGrid:
    return _box(rng, (0.02, -0.03, 0.25), (0.01, 0.01, 0.01), 0.25e-3)


GRIDS: dict[str, Callable[[Rng], VoxelGrid]] = {
    "paper": _paper, "near": _near, "touching": _touching, "edge": _edge, "off axis": _off_axis,
    "far": _far, "very far": _very_far, "huge": _huge, "deep": _deep, "tiny": _tiny, "thin": _thin,
    "uneven": _uneven, "fine": _fine,
}  # fmt: skip


def one(number: int, seed: int, device: clradar.Device, chosen: dict[str, str]) -> dict[str, Any]:
    """Draw a case, image it and compare."""
    rng = np.random.default_rng([seed, number])
    kind = {
        name: chosen.get(name) or str(rng.choice(list(table)))
        for name, table in (("array", ARRAYS), ("waveform", WAVEFORMS), ("grid", GRIDS))
    }
    array = ARRAYS[kind["array"]](rng)
    waveform = WAVEFORMS[kind["waveform"]](rng)
    grid = GRIDS[kind["grid"]](rng)
    tolerance_db = float(rng.choice([-30, -40, -50, -50, -60, -70, -80]))
    kind["data"] = str(rng.choice(["noise", "scatterers", "scatterers"]))
    last_m = grid.origin_m + grid.spacing_m * (np.array(grid.counts) - 1)
    points = rng.uniform(grid.origin_m, last_m, (200, 3))
    capture = (noise if kind["data"] == "noise" else echoes)(array, waveform, points, rng)

    start = time.perf_counter()
    volume = clradar.backproject(
        capture, grid, method="fast", tolerance_db=tolerance_db, device=device, check_grid=False
    )
    seconds = time.perf_counter() - start
    levels, skeleton = block_tree.image_levels(array, waveform, grid, 10.0 ** (tolerance_db / 20.0))
    kept = 1.0 if skeleton is None else np.prod(skeleton.counts) / np.prod(levels[-1].voxels)
    last = np.array(grid.counts) - 1
    corners = np.array(np.meshgrid(*zip((0, 0, 0), last, strict=True))).reshape(3, -1).T
    at = np.concatenate([corners, rng.integers(0, last + 1, (N_VOXELS, 3))])
    want = exact(capture, grid.origin_m + grid.spacing_m * at)
    error = np.abs(volume.data[at[:, 2], at[:, 1], at[:, 0]] - want)
    rms = np.sqrt(np.mean(np.abs(want[8:]) ** 2))

    def level_db(values: np.ndarray) -> float:
        return float(20 * np.log10(max(np.sqrt(np.mean(values**2)) / rms, 1e-30)))

    return {
        "case": number, **kind, "tx": array.n_tx, "rx": array.n_rx, "steps": waveform.n_freq,
        "counts": list(grid.counts), "tolerance_db": tolerance_db, "error_db": level_db(error[8:]),
        "corners_db": level_db(error[:8]), "seconds": seconds, "kept": float(kept),
    }  # fmt: skip


def _line_of(row: dict[str, Any]) -> str:
    return (
        f"{row['case']:5d} {row['array']:>9} {row['tx']:4d}x{row['rx']:<4d} {row['waveform']:>9} "
        f"{row['steps']:4d} {row['grid']:>9} {row['counts']!s:>16} {row['data']:>10} "
        f"tolerance {row['tolerance_db']:4.0f} error {row['error_db']:6.1f} corners "
        f"{row['corners_db']:6.1f} dB {row['seconds']:5.2f} s, {row['kept']:.2f} summed"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases")
    parser.add_argument("--device", default=None)
    parser.add_argument("--width", type=int, choices=(1, 8), default=None)
    parser.add_argument(
        "--interpolate", action="store_true", help="use skeleton voxels however many there are"
    )
    parser.add_argument("--verbose", action="store_true", help="print every case")
    parser.add_argument("--json", type=Path)
    for name, table in (("array", ARRAYS), ("waveform", WAVEFORMS), ("grid", GRIDS)):
        parser.add_argument(f"--{name}", choices=list(table))
    given = parser.parse_args()
    device = clradar.open_device(given.device, width=given.width)
    fast.FEW_TERMS = 0  # or small cases are summed directly
    if given.interpolate:
        block_tree.FEW_KEPT = np.inf
    chosen = {name: getattr(given, name) for name in ("array", "waveform", "grid")}
    rows = []
    for number in given.only or range(given.cases):
        row = one(number, given.seed, device, chosen)
        rows.append(row)
        beyond = max(row["error_db"], row["corners_db"]) > row["tolerance_db"]
        if beyond or given.verbose:
            print(_line_of(row), flush=True)
    for name in ("error_db", "corners_db"):
        margin = np.array([row["tolerance_db"] - row[name] for row in rows])
        low, middle = margin.min(), np.median(margin)
        missed = int((margin < 0).sum())
        print(f"{name}: {missed} of {len(rows)} beyond; margin {low:.1f} to median {middle:.1f} dB")
    if given.json is not None:
        given.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Error of `method="fast"` over drawn arrays, waveforms, grids and tolerances.

    python benchmarks/fast_accuracy.py [--cases 200] [--first-seed 0] [--width 1] [--interpolate]

Every case is drawn from its own number, so that one that fails can be run again (`--only N`).
Error: RMS over random voxels of the difference to the exact sum, in float64, relative to the RMS of
the exact image over the same voxels; and the same for the corners of the grid alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from core.work import exact_by_gemm, forward_by_gemm
from study import ARRAY as QAR50, Row, parser, run, summarize

import clradar
from clradar import AntennaArray, Capture, VoxelGrid, Waveform
from clradar.imaging import block_tree, fast

N_VOXELS = 400
MOST_VOXELS = 60_000
Rng = np.random.Generator


def recorded(array: AntennaArray, waveform: Waveform, at_m: np.ndarray, rng: Rng) -> Capture:
    """Of point scatterers of random strength, or in a third of the cases noise."""
    if rng.random() < 1 / 3:
        re, im = rng.normal(size=(2, array.n_tx, array.n_rx, waveform.n_freq)).astype(np.float32)
        return Capture(re + 1j * im, array, waveform)
    strength = rng.normal(size=len(at_m)) + 1j * rng.normal(size=len(at_m))
    return Capture(forward_by_gemm(at_m, strength, array, waveform, complex), array, waveform)


def _clusters(rng: Rng) -> AntennaArray:
    def side() -> np.ndarray:
        centres = rng.uniform(-0.08, 0.08, (rng.integers(1, 7), 3)) * [1, 1, 0.1]
        n = int(rng.integers(1, 90))
        spread = rng.normal(0, 0.006, (n, 3)) * [1, 1, 0.2]
        return centres[rng.integers(0, len(centres), n)] + spread

    return AntennaArray(side(), side())


def _line(rng: Rng) -> AntennaArray:
    x = np.linspace(-0.1, 0.1, int(rng.integers(2, 120)))
    line = np.stack([x, 0 * x, 0 * x], axis=1)
    beside = line + np.array([0.0, 0.01, 0.0])
    return AntennaArray(line, line[:, [1, 0, 2]] if rng.random() < 0.5 else beside)


def _ring(rng: Rng) -> AntennaArray:
    turn = np.linspace(0, 2 * np.pi, int(rng.integers(8, 120)), endpoint=False)
    ring = 0.08 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    return AntennaArray(ring, ring[1::2] if rng.random() < 0.5 else 0.5 * ring)


def _in_space(rng: Rng) -> AntennaArray:
    n, m = rng.integers(1, 90, 2)
    size = rng.uniform(0.02, 0.3)
    return AntennaArray(rng.uniform(-size, size, (n, 3)), rng.uniform(-size, size, (m, 3)))


ARRAYS: dict[str, Callable[[Rng], AntennaArray]] = {
    "qar50": lambda rng: QAR50, "clusters": _clusters, "line": _line, "ring": _ring,
    "in space": _in_space,
}  # fmt: skip


def _narrow(rng: Rng) -> Waveform:
    start = rng.uniform(1e9, 300e9)
    return Waveform.sfcw(start, start * 1.003, int(rng.integers(2, 40)))


WAVEFORMS: dict[str, Callable[[Rng], Waveform]] = {
    "sweep": lambda rng: Waveform.sfcw(72e9, 82e9, int(rng.integers(2, 129))),
    "wide": lambda rng: Waveform.sfcw(
        rng.uniform(2e9, 30e9), rng.uniform(50e9, 90e9), int(rng.integers(2, 129))
    ),
    "narrow": _narrow,
    "unequal": lambda rng: Waveform(np.sort(rng.uniform(60e9, 84e9, int(rng.integers(2, 100))))),
    "two bands": lambda rng: Waveform(
        np.concatenate([np.linspace(24e9, 25e9, 20), np.linspace(76e9, 81e9, 40)])
    ),
    "one": lambda rng: Waveform([rng.uniform(1e9, 300e9)]),
}

# centre, size and step, each a number or three, metres.
Box = tuple[object, object, object]

BOXES: dict[str, Callable[[Rng], Box]] = {
    "paper": lambda rng: ((0, 0, 0.3), (0.2, 0.2, 0.08), 1e-3),
    "near": lambda rng: ((0, 0, 0.05), (0.2, 0.2, rng.uniform(0.0, 0.06)), 2e-3),
    "touching": lambda rng: ((0, 0, 0), (0.16, 0.16, 0.05), 2e-3),
    "edge": lambda rng: ((0.07, 0.07, 0.06), (0.06, 0.06, 0.08), 1e-3),
    "off axis": lambda rng: (
        rng.uniform(-0.8, 0.8, 3) * [1, 1, 0.3] + [0, 0, 0.3], rng.uniform(0.02, 0.2, 3), 1.5e-3
    ),
    "far": lambda rng: ((0.1, 0, 2.0), (0.6, 0.6, 0.3), 5e-3),
    "very far": lambda rng: ((5.0, 0, 20.0), (2.0, 2.0, 1.0), 2e-2),
    "huge": lambda rng: (rng.uniform(-9, 9, 3), rng.uniform(0, 20, 3), rng.uniform(0.01, 1)),
    "deep": lambda rng: ((0, 0, 0.55), (0.3, 0.3, 1.0), 2e-3),
    "tiny": lambda rng: (
        rng.uniform((-0.1, -0.1, 0.15), (0.1, 0.1, 0.35)), rng.uniform(0, 0.02, 3),
        rng.uniform(1e-3, 0.02, 3),
    ),
    "thin": lambda rng: (
        (0, 0, rng.uniform(0.12, 0.4)), 0.2 * (np.arange(3) != rng.integers(3)), 1e-3
    ),
    "uneven": lambda rng: ((0, 0, 0.3), (0.15, 0.15, 0.1), rng.uniform(0.2e-3, 8e-3, 3)),
    "fine": lambda rng: ((0.02, -0.03, 0.25), 0.01, 0.25e-3),
}  # fmt: skip


def grid_of(box: Box) -> VoxelGrid:
    """A grid of about that size, coarser where it would have too many voxels."""
    centre, size, step = (np.broadcast_to(np.asarray(v, float), 3) for v in box)
    while (counts := np.floor(size / step).astype(int) + 1).prod() > MOST_VOXELS:
        step = step * np.where(size > 0, 1.2, 1.0)
    n_x, n_y, n_z = (int(n) for n in counts)
    return VoxelGrid(centre - 0.5 * step * (counts - 1), step, (n_x, n_y, n_z))


def one(number: int, seed: int, device: clradar.Device) -> Row:
    """Draw a case, image it and compare."""
    rng = np.random.default_rng([seed, number])
    tables = (ARRAYS, WAVEFORMS, BOXES)
    kinds = [str(rng.choice(list(table))) for table in tables]  # type: ignore[call-overload]
    array, waveform = ARRAYS[kinds[0]](rng), WAVEFORMS[kinds[1]](rng)
    grid = grid_of(BOXES[kinds[2]](rng))
    tolerance_db = float(rng.choice([-30, -40, -50, -50, -60, -70, -80]))
    last = np.array(grid.counts) - 1
    points = rng.uniform(grid.origin_m, grid.origin_m + grid.spacing_m * last, (200, 3))
    capture = recorded(array, waveform, points, rng)
    volume = clradar.backproject(
        capture, grid, method="fast", tolerance_db=tolerance_db, device=device, check_grid=False
    )
    corners = np.array(np.meshgrid(*zip((0, 0, 0), last, strict=True))).reshape(3, -1).T
    at = np.concatenate([corners, rng.integers(0, last + 1, (N_VOXELS, 3))])
    want = exact_by_gemm(capture, grid.origin_m + grid.spacing_m * at, complex)
    error = np.abs(volume.data[at[:, 2], at[:, 1], at[:, 0]] - want)
    rms = np.sqrt(np.mean(np.abs(want[8:]) ** 2))
    levels = [np.sqrt(np.mean(part**2)) / rms for part in (error[8:], error[:8])]
    beyond = (20 * np.log10(max(float(level), 1e-30)) - tolerance_db for level in levels)
    return {
        "kinds": ", ".join(kinds), "antennas": f"{array.n_tx} x {array.n_rx}",
        "steps": waveform.n_freq, "counts": str(grid.counts), "tolerance_db": tolerance_db,
        **dict(zip(("volume_beyond_db", "corners_beyond_db"), beyond, strict=True)),
    }  # fmt: skip


def main() -> None:
    options = parser(__doc__ or "", 200, 0)
    options.add_argument("--device")
    options.add_argument("--width", type=int, choices=(1, 8))
    options.add_argument("--interpolate", action="store_true", help="skeleton voxels always")
    given = options.parse_args()
    device = clradar.open_device(given.device, width=given.width)
    fast.FEW_TERMS = 0  # or small cases are summed directly
    if given.interpolate:
        block_tree.FEW_KEPT = np.inf
    rows = run(given, lambda number: [one(number, given.first_seed, device)])
    summarize(rows, {"all": lambda row: True}, "volume_beyond_db", "corners_beyond_db")


if __name__ == "__main__":
    main()

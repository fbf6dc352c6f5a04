"""Error of `ImagingOperator` at points over drawn arrays, waveforms, points and tolerances.

    .venv/bin/python benchmarks/operator_accuracy.py [--cases 200] [--seed 0] [--width 1]

Every case is drawn from its own number, so that one that fails can be run again (`--only N`).
Forward: RMS over random antennas and frequencies of the difference to the float64 sum, relative to
the RMS of that sum. Adjoint: the same over random points. Dot: the difference of both sides of the
dot test relative to the product of the norms. Prints the cases beyond their tolerance, then the
worst and typical margins.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fast_accuracy import ARRAYS, C_M_PER_S, WAVEFORMS, exact

import clradar
from clradar import AntennaArray, Capture, ImagingOperator, Waveform
from clradar.imaging import fast

MOST_POINTS = 12_000
SOME = 12
"""Transmitters, receivers and frequencies of the forward way that are compared."""
SOME_POINTS = 300
MOST_TERMS = 2e9
"""Samples times points of a case: fewer points are taken of large arrays."""
Rng = np.random.Generator


def samples(
    points_m: np.ndarray, rho: np.ndarray, tx_m: np.ndarray, rx_m: np.ndarray, f_hz: np.ndarray
) -> np.ndarray:
    """The forward way in float64, shape (n_freq, n_tx, n_rx)."""
    lengths_m = [np.linalg.norm(points_m[:, None] - side, axis=-1) for side in (tx_m, rx_m)]
    found = []
    for f in f_hz:
        t, r = (np.exp(-2j * np.pi * f / C_M_PER_S * d) for d in lengths_m)
        found.append((t * rho[:, None]).T @ r)
    return np.array(found)


# Points -------------------------------------------------------------------------------------------


def _cloud(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    return rng.uniform((-0.1, -0.1, 0.2), (0.1, 0.1, 0.35), (n, 3))


def _ball(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    out = rng.normal(size=(n, 3))
    out /= np.linalg.norm(out, axis=1)[:, None]
    return rng.uniform(0.01, 0.08) * out + [0.02, -0.03, rng.uniform(0.1, 0.5)]


def _plane(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    at = rng.uniform(-0.08, 0.08, (n, 3))
    at[:, rng.integers(0, 3)] = 0.0
    return at + np.array([0, 0, rng.uniform(0.1, 0.4)])


def _line(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    ends = rng.uniform((-0.2, -0.2, 0.1), (0.2, 0.2, 0.5), (2, 3))
    return ends[0] + rng.random((n, 1)) * (ends[1] - ends[0])


def _clusters(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    """Most points in a few places, some far from all."""
    middles = rng.uniform((-0.3, -0.3, 0.1), (0.3, 0.3, 0.8), (5, 3))
    at = middles[rng.integers(0, 5, n)] + rng.normal(0, rng.uniform(1e-4, 5e-3), (n, 3))
    lone = rng.random(n) < 0.01
    at[lone] = rng.uniform(-1.0, 1.0, (lone.sum(), 3))
    return at


def _single(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    return rng.uniform((-0.1, -0.1, -0.3), (0.1, 0.1, 0.4), (1, 3))


def _few(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    return rng.uniform((-0.1, -0.1, 0.2), (0.1, 0.1, 0.4), (int(rng.integers(2, 9)), 3))


def _same(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    return np.repeat(_few(rng, array, n), 50, axis=0)


def _at_antennas(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    """All antennas, and points within millimetres of them."""
    both = np.concatenate([array.tx_m, array.rx_m])
    near = both[rng.integers(0, len(both), n // 4)] + rng.normal(0, 3e-3, (n // 4, 3))
    return np.concatenate([both, near])


def _around(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    """Before, behind and among the antennas."""
    return rng.uniform(-0.3, 0.3, (n, 3))


def _far(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    return rng.uniform(-0.3, 0.3, (n, 3)) + np.array([0, 0, 10.0])


def _sparse(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    return rng.uniform((-6, -6, 1), (6, 6, 12), (n // 8 + 1, 3))


def _lattice(rng: Rng, array: AntennaArray, n: int) -> np.ndarray:
    """On the borders of blocks: whole fractions of the points' extent."""
    side = int(rng.integers(2, 23))
    at = np.stack(np.meshgrid(*[np.linspace(-0.05, 0.05, side)] * 3), axis=-1).reshape(-1, 3)
    return at + np.array([0, 0, 0.25])


POINTS: dict[str, Callable[[Rng, AntennaArray, int], np.ndarray]] = {
    "cloud": _cloud, "ball": _ball, "plane": _plane, "line": _line, "clusters": _clusters,
    "single": _single, "few": _few, "same": _same, "antennas": _at_antennas, "around": _around,
    "far": _far, "sparse": _sparse, "lattice": _lattice,
}  # fmt: skip


# Reflectivity -------------------------------------------------------------------------------------


def _all(rng: Rng, points_m: np.ndarray) -> np.ndarray:
    return rng.normal(size=len(points_m)) + 1j * rng.normal(size=len(points_m))


def _one(rng: Rng, points_m: np.ndarray) -> np.ndarray:
    """One point reflects: any, or the outermost in a direction."""
    rho = np.zeros(len(points_m), complex)
    outermost = int((points_m @ rng.normal(size=3)).argmax())
    rho[outermost if rng.random() < 0.5 else rng.integers(0, len(rho))] = 1.0
    return rho


def _decades(rng: Rng, points_m: np.ndarray) -> np.ndarray:
    """Some points are a thousand times as strong as others."""
    return _all(rng, points_m) * 10 ** rng.uniform(-3, 0, len(points_m))


VALUES: dict[str, Callable[[Rng, np.ndarray], np.ndarray]] = {
    "all": _all, "one": _one, "decades": _decades,
}  # fmt: skip


def one(number: int, seed: int, device: clradar.Device, chosen: dict[str, str]) -> dict[str, Any]:
    """Draw a case, apply both ways and compare."""
    rng = np.random.default_rng([seed, number])
    tables: dict[str, Any] = {
        "array": ARRAYS, "waveform": WAVEFORMS, "points": POINTS, "values": VALUES,
    }  # fmt: skip
    kind = {name: chosen.get(name) or str(rng.choice(list(t))) for name, t in tables.items()}
    array: AntennaArray = ARRAYS[kind["array"]](rng)
    waveform: Waveform = WAVEFORMS[kind["waveform"]](rng)
    most = min(MOST_POINTS, MOST_TERMS / (array.n_tx * array.n_rx * waveform.n_freq))
    points_m = POINTS[kind["points"]](rng, array, int(rng.integers(8, max(9, most))))
    rho = VALUES[kind["values"]](rng, points_m).astype(np.complex64)
    tolerance_db = float(rng.choice([-30, -40, -50, -50, -60, -70, -80]))
    shape = (array.n_tx, array.n_rx, waveform.n_freq)
    re, im = rng.normal(size=(2, *shape)).astype(np.float32)
    data = re + 1j * im

    start = time.perf_counter()
    operator = ImagingOperator(array, waveform, points_m, tolerance_db=tolerance_db, device=device)
    got, image = operator.forward(rho), operator.adjoint(data)
    seconds = time.perf_counter() - start

    t, r, f = (np.sort(rng.permutation(n)[:SOME]) for n in shape)
    want = samples(
        points_m, rho.astype(complex), array.tx_m[t], array.rx_m[r], waveform.frequencies_hz[f]
    )
    at = rng.permutation(len(points_m))[:SOME_POINTS]
    want_image = exact(Capture(data, array, waveform), points_m[at]) * data.size
    sides = np.vdot(data, got.astype(complex)), np.vdot(image, rho.astype(complex))
    norms = np.linalg.norm(data) * np.linalg.norm(got)
    return {
        "case": number, **kind, "tx": shape[0], "rx": shape[1], "steps": shape[2],
        "n": len(points_m), "tolerance_db": tolerance_db,
        "forward_db": level_db(got[np.ix_(t, r, f)].transpose(2, 0, 1) - want, want),
        "adjoint_db": level_db(image[at] - want_image, want_image),
        "dot": float(abs(sides[0] - sides[1]) / norms), "seconds": seconds,
    }  # fmt: skip


def level_db(error: np.ndarray, of: np.ndarray) -> float:
    return float(20 * np.log10(max(np.linalg.norm(error) / np.linalg.norm(of), 1e-30)))


def _line_of(row: dict[str, Any]) -> str:
    return (
        f"{row['case']:5d} {row['array']:>9} {row['tx']:4d}x{row['rx']:<4d} {row['waveform']:>9} "
        f"{row['steps']:4d} {row['points']:>9} {row['n']:6d} {row['values']:>8} "
        f"tolerance {row['tolerance_db']:4.0f} forward {row['forward_db']:6.1f} adjoint "
        f"{row['adjoint_db']:6.1f} dB dot {row['dot']:.1e} {row['seconds']:5.2f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases")
    parser.add_argument("--device", default=None)
    parser.add_argument("--width", type=int, choices=(1, 8), default=None)
    parser.add_argument("--verbose", action="store_true", help="print every case")
    parser.add_argument("--json", type=Path)
    for name in ("array", "waveform", "points", "values"):
        parser.add_argument(f"--{name}")
    given = parser.parse_args()
    device = clradar.open_device(given.device, width=given.width)
    fast.FEW_TERMS = 0  # or small cases are summed directly
    chosen = {name: getattr(given, name) for name in ("array", "waveform", "points", "values")}
    rows = []
    for number in given.only or range(given.cases):
        row = one(number, given.seed, device, chosen)
        rows.append(row)
        if max(row["forward_db"], row["adjoint_db"]) > row["tolerance_db"] or given.verbose:
            print(_line_of(row), flush=True)
    for name in ("forward_db", "adjoint_db"):
        margin = np.array([row["tolerance_db"] - row[name] for row in rows])
        low, middle, missed = margin.min(), np.median(margin), int((margin < 0).sum())
        print(f"{name}: {missed} of {len(rows)} beyond; margin {low:.1f} to median {middle:.1f} dB")
    print(f"dot: {max(row['dot'] for row in rows):.1e} at most")
    if given.json is not None:
        given.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()

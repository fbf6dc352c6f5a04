"""Sensitivity of every metric of `clradar.compare` to known differences.

    python benchmarks/metric_evidence.py       # 100 captures: half an hour on two busy cores

Writes tables between the two markers of docs/metrics.md and draws docs/images/metrics.png; prints
further tables. Images that are in its folder are used again: remove it after a change to simulation
or imaging.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from metric_figure import draw
from metric_images import HANDS, SHIFTS_MM, Hand, Shot, Store, along

import clradar
from clradar.compare import HEADLINE_METRIC, HIGHER_IS_BETTER, METRICS, compare
from clradar.files.atomic import replacing
from clradar.plot import save_figure

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- benchmarks/metric_evidence.py -->\n", "<!-- until here -->\n"

ALPHA, NEXT_ALPHA, OTHER_ALPHA = 0.3, 0.4, 0.6
SWEPT = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
MORE_RAYS, MORE_RAYS_HANDS, MORE_RAYS_SWEPT = 16, HANDS[::2], (0.4, 0.5, 0.6, 0.7)
MEASURED_SEEDS = (0, 1)
SIMULATED_SEEDS = (10, 11, 12)
MOVES = tuple(along(axis, mm) for axis in "xz" for mm in SHIFTS_MM)
NAMES = METRICS

Values = dict[str, np.ndarray]
"""Of every metric: shape (hands, measured seeds, simulated seeds), lengths in millimetres."""


def measurements(hand: Hand, alpha: float) -> list[Shot]:
    return [Shot(hand, alpha, seed, noisy=True) for seed in MEASURED_SEEDS]


def simulations(hand: Hand, alpha: float, shift_mm: tuple[int, int, int] = (0, 0, 0)) -> list[Shot]:
    """Return all seeds where the truth is simulated, and one for all that is more."""
    more = any(shift_mm) or alpha not in (ALPHA, OTHER_ALPHA)
    seeds = SIMULATED_SEEDS[:1] if more else SIMULATED_SEEDS
    return [Shot(hand, alpha, seed, shift_mm) for seed in seeds]


def more_rays(hand: Hand, alpha: float) -> list[Shot]:
    return [Shot(hand, alpha, SIMULATED_SEEDS[0], rays=MORE_RAYS)]


def shots() -> Iterator[Shot]:
    for hand in HANDS:
        for alpha in (ALPHA, OTHER_ALPHA):
            yield from measurements(hand, alpha)
        for alpha in SWEPT:
            yield from simulations(hand, alpha)
        for shift_mm in MOVES:
            yield from simulations(hand, ALPHA, shift_mm)
    for hand in MORE_RAYS_HANDS:
        for alpha in MORE_RAYS_SWEPT:
            yield from more_rays(hand, alpha)


def make_images(store: Store) -> None:
    wanted = [shot for shot in shots() if not store.has(shot)]
    for i, shot in enumerate(wanted):
        start_s = time.perf_counter()
        store.make(shot)
        took_s = time.perf_counter() - start_s
        print(f"{i + 1} of {len(wanted)}: {shot.file_name}, {took_s:.1f} s", flush=True)


def other_pose(hand: Hand) -> Hand:
    """Return the other hand that is turned like this one."""
    return next(h for h in HANDS if h.turn_deg == hand.turn_deg and h != hand)


class Evidence:
    """The metrics of pairs of images: a measurement, and what is simulated for it."""

    def __init__(self, store: Store, every: int = 1) -> None:
        """Take `every` pixel along x and y."""

        def image(shot: Shot, shift_mm: tuple[int, int, int]) -> clradar.DepthMap:
            full = store.image(shot, shift_mm)
            maps = (full.depth_m[::every, ::every], full.amplitude[::every, ::every])
            axes = (full.x_m[::every], full.y_m[::every])
            return clradar.DepthMap(*maps, *axes, full.dynamic_range_db)

        self.image = lru_cache(maxsize=None)(image)

    def against(
        self,
        alpha: float,
        simulated: Callable[[Hand], list[Shot]],
        hands: tuple[Hand, ...] = HANDS,
    ) -> Values:
        """Compare the measurements of every hand with simulations."""
        found = [
            [[self._row(m, s) for s in simulated(hand)] for m in measurements(hand, alpha)]
            for hand in hands
        ]
        return _by_name(np.array(found))

    def moved(self, shift_mm: tuple[int, int, int]) -> Values:
        """Compare simulated images with themselves, moved by whole voxels."""
        found = [[[self._row(s, s, shift_mm) for s in simulations(hand, ALPHA)]] for hand in HANDS]
        return _by_name(np.array(found))

    def _row(self, a: Shot, b: Shot, shift_mm: tuple[int, int, int] = (0, 0, 0)) -> list[float]:
        metrics = compare(self.image(a, (0, 0, 0)), self.image(b, shift_mm))
        return [getattr(metrics, n) * (1e3 if n.endswith("_m") else 1.0) for n in NAMES]


def _by_name(found: np.ndarray) -> Values:
    return {name: found[..., i] for i, name in enumerate(NAMES)}


def spread(values: np.ndarray) -> float:
    """Return the standard deviation over the pairs of seeds of one hand, RMS over the hands."""
    pairs = values.reshape(len(values), -1)
    return float(np.sqrt(np.mean(pairs.var(axis=1, ddof=1))))


def label(name: str) -> str:
    return f"`{name}`" + (", mm" if name.endswith("_m") else "")


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def digits(name: str) -> int:
    return 2 if name.endswith("_m") else 3


def known_differences(evidence: Evidence) -> dict[str, Values]:
    """Compare measurements with the same, with moved hands, and with another pose."""
    shifts = {"ceiling": (0, 0, 0), **{shift_name(m): m for m in MOVES}}
    found = {
        name: evidence.against(ALPHA, lambda hand, m=m: simulations(hand, ALPHA, m))
        for name, m in shifts.items()
    }
    floor = evidence.against(ALPHA, lambda hand: simulations(other_pose(hand), ALPHA))
    return {**found, "another pose": floor}


def known_pairs(columns: dict[str, Values]) -> str:
    """Every metric of every known difference, with its spread over seeds."""
    rows = []
    for name in NAMES:
        n = digits(name)
        cells = [f"{v[name].mean():.{n}f} ± {spread(v[name]):.{n + 1}f}" for v in columns.values()]
        rows.append([label(name), *cells])
    return table(["metric", *columns], rows)


def per_hand(name: str, columns: dict[str, Values]) -> str:
    rows = [
        [hand.name, *(f"{v[name][i].mean():.{digits(name)}f}" for v in columns.values())]
        for i, hand in enumerate(HANDS)
    ]
    return table([label(name), *columns], rows)


def effect(name: str, ceiling: Values, values: Values) -> float:
    """Return how many spreads of the ceiling the values are worse than the ceiling."""
    difference = float(np.mean(values[name].mean(axis=(1, 2)) - ceiling[name].mean(axis=(1, 2))))
    return (-difference if name in HIGHER_IS_BETTER else difference) / spread(ceiling[name])


def lost(name: str, ceiling: Values, values: Values, floor: Values) -> float:
    """Return the difference from the ceiling as a fraction of that between ceiling and floor."""
    top, at, bottom = (v[name].mean(axis=(1, 2)) for v in (ceiling, values, floor))
    return float(np.mean((at - top) / (bottom - top)))


def ordered(name: str, steps: list[Values]) -> int:
    """Return for how many hands each step is worse than the one before."""
    worse = -1.0 if name in HIGHER_IS_BETTER else 1.0
    means = worse * np.array([v[name].mean(axis=(1, 2)) for v in steps])
    return int((np.diff(means, axis=0) > 0).all(axis=0).sum())


def judged(pairs: dict[str, Values], alpha_step: Values) -> str:
    """The table of every metric: effect sizes, fractions lost, and correct orders."""
    ceiling, floor = pairs["ceiling"], pairs["another pose"]
    rows = []
    for name in NAMES:
        changes = (pairs["x 1 mm"], pairs["z 1 mm"], alpha_step)
        effects = [str(round(effect(name, ceiling, v))) for v in changes]
        at = ("x 1 mm", "x 5 mm", "z 1 mm", "z 5 mm")
        shares = [f"{round(100 * lost(name, ceiling, pairs[key], floor))} %" for key in at]
        orders = [
            str(ordered(name, [ceiling, *(pairs[f"{axis} {mm} mm"] for mm in SHIFTS_MM)]))
            for axis in "xz"
        ]
        rows.append([label(name), *effects, *shares, *orders])
    head = [
        *("metric", "effect of x 1 mm", "effect of z 1 mm", f"effect of alpha {NEXT_ALPHA:g}"),
        *("way at x 1 mm", "x 5 mm", "z 1 mm", "z 5 mm", "ordered in x", "in z"),
    ]
    return table(head, rows)


def sweep_table(sweep: dict[float, Values]) -> str:
    rows = [
        [label(n), *(f"{v[n][..., 0].mean():.{digits(n)}f}" for v in sweep.values())] for n in NAMES
    ]
    return table(["metric", *(f"alpha = {a:g}" for a in sweep)], rows)


def best_alphas(name: str, sweep: dict[float, Values]) -> np.ndarray:
    """Return the best alpha of the sweep for each hand and measurement."""
    # The first seed is the one that all of the sweep share.
    one = np.array([v[name][..., 0] for v in sweep.values()])
    at = one.argmax(axis=0) if name in HIGHER_IS_BETTER else one.argmin(axis=0)
    return np.array(list(sweep))[at]


def best_alpha_table(sweeps: dict[str, dict[float, Values]]) -> str:
    rows = []
    for name in NAMES:
        found = [best_alphas(name, sweep) for sweep in sweeps.values()]
        cells = [f"{f.mean():.2f} ({f.min():g} to {f.max():g})" for f in found]
        rows.append([label(name), *cells])
    return table(["metric", *sweeps], rows)


def moved_table(evidence: Evidence) -> str:
    shifts = [along(axis, mm) for axis in "xyz" for mm in SHIFTS_MM]
    moved = [evidence.moved(s) for s in shifts]
    rows = [[label(n), *(f"{v[n].mean():.{digits(n)}f}" for v in moved)] for n in NAMES]
    return table(["metric", *map(shift_name, shifts)], rows)


def shift_name(shift_mm: tuple[int, int, int]) -> str:
    return f"{'xyz'[int(np.argmax(shift_mm))]} {max(shift_mm)} mm"


def rewrite(page: Path, text: str) -> None:
    """Put the text between the markers of a page."""
    before, rest = page.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    with replacing(page, force=True) as path:
        path.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=Path, default=ROOT / "benchmarks/metric_images")
    folder = parser.parse_args().images
    folder.mkdir(parents=True, exist_ok=True)
    store = Store(folder, clradar.open_device(None))
    make_images(store)

    evidence = Evidence(store)

    pairs = known_differences(evidence)
    coarse = known_differences(Evidence(store, every=2))

    def against(truth: float, choose: Callable[..., list[Shot]], *arguments: Any) -> Values:
        return evidence.against(truth, lambda hand: choose(hand, *arguments))

    sweeps = {
        f"measured at alpha = {truth:g}": {a: against(truth, simulations, a) for a in SWEPT}
        for truth in (ALPHA, OTHER_ALPHA)
    }
    clearer = {
        a: evidence.against(OTHER_ALPHA, lambda h, a=a: more_rays(h, a), MORE_RAYS_HANDS)
        for a in MORE_RAYS_SWEPT
    }
    sweep = sweeps[f"measured at alpha = {ALPHA:g}"]
    text = "\n".join(
        [
            "**Known differences.** Mean over hands and seeds ± spread over seeds.\n",
            known_pairs(pairs),
            "**Sensitivity.** The columns are explained above.\n",
            judged(pairs, sweep[NEXT_ALPHA]),
            "**The best alpha.** Estimate by each metric: mean (range) over hands, measurements.\n",
            best_alpha_table({**sweeps, f"at {OTHER_ALPHA:g}, {MORE_RAYS} rays": clearer}),
        ]
    )
    tables = (f"**Other alpha**, {truth}.\n\n{sweep_table(s)}" for truth, s in sweeps.items())
    for more in (
        f"**The headline for each hand.**\n\n{per_hand(HEADLINE_METRIC, pairs)}",
        *tables,
        f"**The same image moved**, with the same seed.\n\n{moved_table(evidence)}",
        f"**Pixels of 2 mm**: every second pixel of the first table's.\n\n{known_pairs(coarse)}",
    ):
        print(more)
    print(text)
    rewrite(ROOT / "docs/metrics.md", text)
    save_figure(draw(NAMES, pairs, sweeps), ROOT / "docs/images/metrics.png", force=True)


if __name__ == "__main__":
    main()

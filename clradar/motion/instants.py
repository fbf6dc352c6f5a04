"""Instants at which a moving scene is simulated, and the interpolation between them.

E15 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Waveform
from clradar.motion.bodies import BodyInSweep, SceneInSweep

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128,
          160, 192, 224, 256)  # fmt: skip
"""Numbers of instants that are tried for a group of Tx."""

PARTS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024)
"""Numbers of groups that are tried."""

DIRECT = 32
"""Most samples of a piece that have each their own instant."""

CHECKED = 2**12
"""Most times at which an interpolation is checked: what 256 instants can follow needs fewer."""

_DIRECTIONS = np.array(sorted(set(product((-1, 0, 1), repeat=3)) - {(0, 0, 0)}))
_SAMPLED_TIMES = 8
_FASTEST = 8


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Some Tx, and when the scene is simulated for them.

    `pieces_s` are instants of each piece of the time in which these Tx record: its Chebyshev
    points, or all times of its samples; pieces meet at `cuts_s`. The error is that of the
    interpolated phasors of probes on the surface, relative to their amplitude.
    """

    tx: np.ndarray
    pieces_s: tuple[np.ndarray, ...]
    cuts_s: np.ndarray
    error: float

    @property
    def times_s(self) -> np.ndarray:
        """All instants."""
        return np.concatenate(self.pieces_s)

    def shares(self, times_s: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the share of each instant at some times: of the shape of the times."""
        piece = np.searchsorted(self.cuts_s, times_s, side="right")
        for number, nodes_s in enumerate(self.pieces_s):
            for share in weights(nodes_s, times_s):
                yield np.where(piece == number, share, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """The way of a point through three places: a parabola over time.

    `places_m`, shape (3, 3), metres, at the beginning, in the middle and at the end.
    """

    begin_s: float
    end_s: float
    places_m: np.ndarray

    def at_m(self, times_s: np.ndarray) -> np.ndarray:
        """Where the point is, shape (*times_s.shape, 3), metres."""
        x = 2.0 * (np.asarray(times_s)[..., None] - self.begin_s) / (self.end_s - self.begin_s) - 1
        first, middle, last = self.places_m
        bend = 0.5 * (first + last) - middle
        return np.asarray(middle + 0.5 * x * (last - first) + x * x * bend)


@dataclass(frozen=True, slots=True, eq=False)
class Probes:
    """Points that stand for the surface of all bodies: some vertices (`rows`) of each.

    `way` is about the way of the middle of the bodies that move, None: nothing does. 1 % of the
    faces of carried skin become longer by `stretch` at least.
    """

    bodies: tuple[BodyInSweep, ...]
    rows: tuple[np.ndarray, ...]
    marks_s: np.ndarray
    way: Way | None
    stretch: float
    _known: dict[float, np.ndarray] = field(default_factory=dict)

    @classmethod
    def of(cls, sweep: SceneInSweep, begin_s: float, end_s: float) -> Probes:
        """The vertices of every body that are outermost, and those that move most."""
        rows, ways, stretch = [], [], 1.0
        for body in sweep.bodies:
            marks_s = body.marks_s
            some = np.linspace(0, max(len(marks_s) - 1, 0), _SAMPLED_TIMES).astype(int)
            times_s = [begin_s, 0.5 * (begin_s + end_s), end_s, *marks_s[some[: len(marks_s)]]]
            at_m = np.stack([body.vertices_m(time_s) for time_s in times_s])
            away_m = np.linalg.norm(at_m - at_m[0], axis=2).max(axis=0)
            outermost = (at_m[1] @ _DIRECTIONS.T).argmax(axis=0)
            own = np.unique([*outermost, *np.argsort(-away_m, kind="stable")[:_FASTEST]])
            rows.append(own)
            if len(marks_s):
                ways.append(at_m[:3, own].mean(axis=1))
            if len(marks_s) and len(body.carried):
                corners_m = at_m[:, body.carried]
                edges_m = np.linalg.norm(corners_m - np.roll(corners_m, 1, axis=2), axis=3)
                longest_m = edges_m.max(axis=2)
                longer = longest_m / np.maximum(longest_m[1], np.finfo(float).tiny)
                stretch = max(stretch, float(np.quantile(longer, 0.99, axis=1).max()))
        way = Way(begin_s, end_s, np.mean(ways, axis=0)) if ways else None
        all_s = np.unique(np.concatenate([body.marks_s for body in sweep.bodies]))
        return cls(sweep.bodies, tuple(rows), all_s, way, stretch)

    def at_m(self, times_s: np.ndarray) -> np.ndarray:
        """Their places, shape (n_times, n, 3), metres."""
        for time_s in times_s:
            if float(time_s) not in self._known:
                parts = zip(self.bodies, self.rows, strict=True)
                at_m = [body.vertices_m(time_s, rows) for body, rows in parts]
                self._known[float(time_s)] = np.concatenate(at_m)
        return np.stack([self._known[float(time_s)] for time_s in times_s])


def chebyshev_times_s(begin_s: float, end_s: float, count: int) -> np.ndarray:
    """Return the `count` Chebyshev points of the first kind between two times."""
    angle = (np.arange(count) + 0.5) * np.pi / count
    return np.asarray(0.5 * (begin_s + end_s) - 0.5 * (end_s - begin_s) * np.cos(angle))


def weights(nodes_s: np.ndarray, times_s: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the share of each Chebyshev point at some times: of the shape of the times.

    Barycentric Lagrange interpolation (Berrut and Trefethen, SIAM Review 46 (2004) 501).
    """
    count = len(nodes_s)
    if count == 1:
        yield np.ones(np.shape(times_s))
        return
    angle = (np.arange(count) + 0.5) * np.pi / count
    own = np.sin(angle) * (-1.0) ** np.arange(count)
    # Relative to the interval, so that no time scale is special.
    scale_s = nodes_s[-1] - nodes_s[0]
    total = np.zeros(np.shape(times_s))
    hit = np.zeros(np.shape(times_s), dtype=bool)
    for node_s, weight in zip(nodes_s, own, strict=True):
        away = (times_s - node_s) / scale_s
        hit |= away == 0.0
        total += weight / np.where(away == 0.0, 1.0, away)
    for node_s, weight in zip(nodes_s, own, strict=True):
        away = (times_s - node_s) / scale_s
        here = away == 0.0
        share = weight / np.where(here, 1.0, away) / np.where(total == 0.0, 1.0, total)
        yield np.where(hit, here.astype(float), share)


def plan_groups(
    probes: Probes,
    array: AntennaArray,
    waveform: Waveform,
    times_s: np.ndarray,
    tolerance: float,
    overhead_tx: float,
    *,
    follow: Way | None,
    cut: bool,
    budget: float,
) -> tuple[float, list[Group]] | None:
    """Divide the Tx into groups that record together, with as few instants as the tolerance allows.

    Returns their cost, and the groups; None: no division costs less than the budget, in Tx, or 256
    instants are too few for any. Samples are recorded at `times_s` (n_tx, n_rx or 1, n_freq); the
    tolerance is of `Group.error`; a simulation costs `overhead_tx` without its Tx. Phases are taken
    relative to that of a point that goes the way `follow`; with `cut` they are interpolated between
    `Probes.marks_s` only.
    """
    order = np.argsort(times_s.mean(axis=(1, 2)), kind="stable")

    def planned(tx: np.ndarray) -> Group:
        return _planned(tx, probes, array, waveform, times_s[tx], tolerance, follow, cut=cut)

    def cost(group: Group, n_tx: float) -> float:
        spent = len(group.times_s) * (overhead_tx + n_tx)
        return spent if group.error <= tolerance else np.inf

    costs = []
    for parts in sorted({min(parts, array.n_tx) for parts in PARTS}):
        middle = planned(np.array_split(order, parts)[parts // 2])
        costs.append((parts * cost(middle, array.n_tx / parts), parts))
    for expected, parts in sorted(costs):
        groups, total = [], 0.0
        if expected < budget:
            for tx in np.array_split(order, parts):
                groups.append(planned(tx))
                total += cost(groups[-1], len(tx))
                if total >= budget:
                    break
            else:
                return total, groups
    return None


def _planned(
    tx: np.ndarray,
    probes: Probes,
    array: AntennaArray,
    waveform: Waveform,
    recorded_s: np.ndarray,
    tolerance: float,
    follow: Way | None,
    *,
    cut: bool,
) -> Group:
    """The group of these Tx with the fewest instants whose error is within the tolerance."""
    distinct_s = np.unique(recorded_s)
    marks_s = probes.marks_s
    marks_s = marks_s[(marks_s > distinct_s[0]) & (marks_s < distinct_s[-1])]
    ends = array.tx_m[tx][_extremes(array.tx_m[tx])], array.rx_m[_extremes(array.rx_m)]
    rate = 2 * np.pi * float(waveform.frequencies_hz.max()) / SPEED_OF_LIGHT_M_PER_S

    def phases(at_s: np.ndarray) -> np.ndarray:
        lengths_m = _lengths_m(probes.at_m(at_s), *ends)
        if follow is not None:
            lengths_m = lengths_m - _lengths_m(follow.at_m(at_s)[:, None], *ends)
        return rate * lengths_m

    cuts_s = marks_s if cut else marks_s[:0]
    own = np.searchsorted(cuts_s, distinct_s, side="right")
    # Pieces in which no sample is recorded need no instant.
    with_samples, first = np.unique(own, return_index=True)
    cuts_s = cuts_s[with_samples[1:] - 1]
    pieces_s, error = [], 0.0
    for piece_s in np.split(distinct_s, first[1:]):
        nodes_s, own_error = _instants_s(piece_s, marks_s, phases, tolerance)
        pieces_s.append(nodes_s)
        error = max(error, own_error)
        if error > tolerance:
            break
    return Group(tx, tuple(pieces_s), cuts_s, error)


def _instants_s(
    samples_s: np.ndarray,
    marks_s: np.ndarray,
    phases: Callable[[np.ndarray], np.ndarray],
    tolerance: float,
) -> tuple[np.ndarray, float]:
    """The fewest instants that are enough for samples at some times (n,), and their error."""
    begin_s, end_s = samples_s[[0, -1]]
    inside_s = marks_s[(marks_s > begin_s) & (marks_s < end_s)]

    def asked_s(count: int) -> np.ndarray:
        made = np.union1d(np.linspace(begin_s, end_s, 4 * count + 9), inside_s)
        return made if len(made) < len(samples_s) else samples_s

    # Between two of these times no body turns by more than an eighth of a turn, nor does a phase
    # by more than a quarter: nothing can come back unseen.
    true_s = asked_s(1)
    if len(true_s) < min(len(samples_s), CHECKED):
        steps = np.abs(np.diff(phases(true_s), axis=0)).max(axis=(1, 2, 3)) / (0.5 * np.pi)
        steps = np.ceil(np.maximum(steps, 1.0))
        if steps.sum() < min(len(samples_s), CHECKED):
            ways = zip(true_s[:-1], true_s[1:], steps.astype(int), strict=True)
            inside_s = np.concatenate([np.linspace(*way, endpoint=False) for way in ways])
        else:
            inside_s = samples_s
        true_s = asked_s(1)
    if len(true_s) > CHECKED:
        return samples_s, np.inf
    true = np.exp(-1j * phases(true_s))
    # A polynomial has no more zeros than its degree.
    over, under = true.real > tolerance, true.real < -tolerance
    crossings = over[1:] & under[:-1] | over[:-1] & under[1:]
    fewest = 1 + int(crossings.sum(axis=0).max())
    nodes_s, error = samples_s[:1], np.inf
    for count in COUNTS:
        if len(samples_s) <= min(count, DIRECT):
            return samples_s, 0.0
        if count < fewest:
            continue
        nodes_s = chebyshev_times_s(begin_s, end_s, count)
        if len(true_s) < min(2 * count, len(samples_s)):
            true_s = asked_s(count)
            true = np.exp(-1j * phases(true_s))
        known = np.exp(-1j * phases(nodes_s))
        shares = np.stack(list(weights(nodes_s, true_s)))
        error = float(np.abs(np.tensordot(shares, known, (0, 0)) - true).max())
        if error <= tolerance:
            break
    return nodes_s, error


def _lengths_m(points_m: np.ndarray, tx_m: np.ndarray, rx_m: np.ndarray) -> np.ndarray:
    """Two-way lengths, shape (n_times, n_points, n_tx, n_rx), of points (n_times, n_points, 3)."""
    legs = [np.linalg.norm(points_m[:, :, None] - ends_m, axis=3) for ends_m in (tx_m, rx_m)]
    return np.asarray(legs[0][..., :, None] + legs[1][..., None, :])


def _extremes(at_m: np.ndarray) -> np.ndarray:
    """Rows of the antennas at the ends of an aperture."""
    return np.unique([*at_m.argmin(axis=0), *at_m.argmax(axis=0), len(at_m) // 2])

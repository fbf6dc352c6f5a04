"""Instants at which a moving scene is simulated, and the interpolation between them.

E15 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ModelError
from clradar.model import AntennaArray, Waveform
from clradar.motion.bodies import BodyInSweep, SceneInSweep

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128,
          160, 192, 224, 256)  # fmt: skip
"""Numbers of instants that are tried for a group of Tx."""

PARTS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024)
"""Numbers of groups that are tried."""

_DIRECTIONS = np.array(sorted(set(product((-1, 0, 1), repeat=3)) - {(0, 0, 0)}))
_SAMPLED_TIMES = 9
_FASTEST = 8


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Some Tx, and when the scene is simulated for them.

    Attributes
    ----------
    tx : ndarray, shape (n,), int
    times_s : ndarray, shape (n_instants,), seconds
        Chebyshev points of the time in which these Tx record.
    error : float
        Of the interpolated phasors of probes on the surface, relative to their amplitude.
    """

    tx: np.ndarray
    times_s: np.ndarray
    error: float


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
    """Points that stand for the surface of all bodies.

    Attributes
    ----------
    bodies, rows : tuple
        The bodies, and which vertices of each.
    way : Way or None
        About the way of the middle of the bodies that move; None: nothing does.
    """

    bodies: tuple[BodyInSweep, ...]
    rows: tuple[np.ndarray, ...]
    way: Way | None

    @classmethod
    def of(cls, sweep: SceneInSweep, begin_s: float, end_s: float) -> Probes:
        """The vertices of every body that are outermost, and those that move most."""
        times_s = np.linspace(begin_s, end_s, _SAMPLED_TIMES)
        rows, ways = [], []
        for body in sweep.bodies:
            at_m = np.stack([body.vertices_m(time_s) for time_s in times_s])
            away_m = np.linalg.norm(at_m - at_m[0], axis=2).max(axis=0)
            outermost = (at_m[_SAMPLED_TIMES // 2] @ _DIRECTIONS.T).argmax(axis=0)
            own = np.unique([*outermost, *np.argsort(-away_m, kind="stable")[:_FASTEST]])
            rows.append(own)
            if away_m.any():
                ways.append(at_m[:: _SAMPLED_TIMES // 2, own].mean(axis=1))
        way = Way(begin_s, end_s, np.mean(ways, axis=0)) if ways else None
        return cls(sweep.bodies, tuple(rows), way)

    def at_m(self, times_s: np.ndarray) -> np.ndarray:
        """Their places, shape (n_times, n, 3), metres."""
        parts = list(zip(self.bodies, self.rows, strict=True))
        places = [[body.vertices_m(time, rows) for body, rows in parts] for time in times_s]
        return np.stack([np.concatenate(own) for own in places])


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
) -> list[Group]:
    """Divide the Tx into groups that record together, with as few instants as the tolerance allows.

    Parameters
    ----------
    probes : Probes
    array : AntennaArray
    waveform : Waveform
    times_s : ndarray, shape (n_tx, n_rx or 1, n_freq), seconds
    tolerance : float
        Of `Group.error`.
    overhead_tx : float
        What a simulation costs without its Tx, in Tx.
    follow : Way or None
        Phases are taken relative to that of a point that goes this way.

    Raises
    ------
    ModelError
        The scene moves so fast that 256 instants are too few for any division.
    """
    order = np.argsort(times_s.mean(axis=(1, 2)), kind="stable")
    best: tuple[float, int] | None = None
    for parts in sorted({min(parts, array.n_tx) for parts in PARTS}):
        groups = np.array_split(order, parts)
        middle = _planned(groups[parts // 2], probes, array, waveform, times_s, tolerance, follow)
        if middle.error <= tolerance:
            cost = parts * len(middle.times_s) * (overhead_tx + array.n_tx / parts)
            if best is None or cost < best[0]:
                best = cost, parts
            elif cost > 2 * best[0]:
                break
    if best is not None:
        made = [
            _planned(tx, probes, array, waveform, times_s, tolerance, follow)
            for tx in np.array_split(order, best[1])
        ]
        if all(group.error <= tolerance for group in made):
            return made
    raise ModelError(
        f"simulate_moving: expected a movement that {COUNTS[-1]} instants can follow while a group "
        "of Tx records, got a faster one; are the times in seconds and the shifts in metres? A "
        "table of shorter times or a larger tolerance_db makes it possible"
    )


def _planned(
    tx: np.ndarray,
    probes: Probes,
    array: AntennaArray,
    waveform: Waveform,
    times_s: np.ndarray,
    tolerance: float,
    follow: Way | None,
) -> Group:
    """The group of these Tx with the fewest instants whose error is within the tolerance."""
    begin_s, end_s = float(times_s[tx].min()), float(times_s[tx].max())
    if begin_s == end_s:
        return Group(tx, np.array([begin_s]), 0.0)
    ends = array.tx_m[tx][_extremes(array.tx_m[tx])], array.rx_m[_extremes(array.rx_m)]
    rate = 2 * np.pi * float(waveform.frequencies_hz.max()) / SPEED_OF_LIGHT_M_PER_S

    def phasors(at_s: np.ndarray) -> np.ndarray:
        lengths_m = _lengths_m(probes.at_m(at_s), *ends)
        if follow is not None:
            lengths_m = lengths_m - _lengths_m(follow.at_m(at_s)[:, None], *ends)
        return np.exp(-1j * rate * lengths_m)

    error = np.inf
    nodes_s = np.array([begin_s])
    true, true_s = np.empty(0), np.empty(0)
    for count in COUNTS:
        nodes_s = chebyshev_times_s(begin_s, end_s, count)
        if len(true_s) < 2 * count:
            true_s = np.linspace(begin_s, end_s, 4 * count + 9)
            true = phasors(true_s)
        known = phasors(nodes_s)
        shares = np.stack(list(weights(nodes_s, true_s)))
        error = float(np.abs(np.tensordot(shares, known, (0, 0)) - true).max())
        if error <= tolerance:
            break
    return Group(tx, nodes_s, error)


def _lengths_m(points_m: np.ndarray, tx_m: np.ndarray, rx_m: np.ndarray) -> np.ndarray:
    """Two-way lengths, shape (n_times, n_points, n_tx, n_rx), of points (n_times, n_points, 3)."""
    legs = [np.linalg.norm(points_m[:, :, None] - ends_m, axis=3) for ends_m in (tx_m, rx_m)]
    return np.asarray(legs[0][..., :, None] + legs[1][..., None, :])


def _extremes(at_m: np.ndarray) -> np.ndarray:
    """Rows of the antennas at the ends of an aperture."""
    return np.unique([*at_m.argmin(axis=0), *at_m.argmax(axis=0), len(at_m) // 2])

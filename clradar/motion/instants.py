"""When samples are recorded, at which instants a moving scene is simulated, and interpolation.

E15 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ModelError, warn
from clradar.model import AntennaArray, Waveform, checks
from clradar.model.record import Record
from clradar.motion.rigid import BodyInSweep

STEP_S = 2.5e-6
"""Time of one frequency at one Tx. The imager's own is not published: this is an assumption, by
which its 94 Tx and 128 frequencies take 30 ms."""

RATE_HZ = 8.0  # frames per second of the recordings that are known
ORDERS = ("tx", "frequency")

COUNTS = tuple(sorted({round(2 ** (step / 4)) for step in range(33)}))
"""Numbers of instants that are tried for a piece, 1 to 256."""

PARTS = tuple(2**step for step in range(11))  # numbers of parts of the Tx that are tried
NODES = 16  # places of a probe between two marks: of an eighth of a turn their polynomial is exact
MOST_INSTANTS = 2048
"""Of a sweep. What needs more is most likely in another unit."""

TORN = 3.0
"""Times that 1 % of the faces of skin are longer: captures of skin that was carried so far were off
by -24 to -6 dB, of less by -41 to -15 dB (docs/movement.md)."""

_DIRECTIONS = np.array(sorted(set(product((-1, 0, 1), repeat=3)) - {(0, 0, 0)}))
_SAMPLED_TIMES = 8
_FASTEST = 8


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SweepTiming(Record):
    """When the samples of one sweep are recorded, from its beginning on.

    Parameters
    ----------
    times_s : array_like, shape (n_tx, n_rx or 1, n_freq), float64
        Of every sample; with one column all Rx record at the same time.
    """

    times_s: Any

    def __post_init__(self) -> None:
        self._set_array("times_s", np.float64, (None, None, None), " (tx, rx or 1, freq)")

    @classmethod
    def in_order(
        cls, n_tx: int, n_freq: int, *, step_s: float = STEP_S, order: str = "tx"
    ) -> SweepTiming:
        """Return the timing of Tx that take turns, a sample each `step_s`, at all Rx at once.

        The order "tx" records all frequencies at each Tx, "frequency" switches through all Tx at
        each frequency; a step of 0 records all at once.
        """
        n_tx = checks.whole("n_tx", n_tx, 1)
        n_freq = checks.whole("n_freq", n_freq, 1)
        step_s = checks.within("step_s", step_s, 0.0, np.inf, " s")
        checks.one_of("order", order, ORDERS)
        tx, step = np.arange(n_tx)[:, None, None], np.arange(n_freq)[None, None]
        slot = tx * n_freq + step if order == "tx" else step * n_tx + tx
        return cls(slot * step_s)

    @property
    def begin_s(self) -> float:
        """Time of the first sample."""
        return float(self.times_s.min())

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return float(self.times_s.max())


def too_fast() -> ModelError:
    return ModelError(
        f"simulate_moving: expected a movement that {MOST_INSTANTS} instants can follow, got a "
        "faster one; are the times in seconds and the shifts in metres? A table of shorter "
        "times or a larger tolerance_db makes it possible"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A piece of the time, the Tx that record in it, and the instants at which they are simulated.

    Instants are its Chebyshev points or, `direct`, the times of all its samples. The error is that
    of the interpolated phasors of probes, relative to their amplitude.
    """

    begin_s: float
    end_s: float
    times_s: np.ndarray
    direct: bool = False
    tx: Any = ()
    error: float = 0.0

    @classmethod
    def between(cls, begin_s: float, end_s: float, count: int) -> Piece:
        """Return the Chebyshev points of the first kind between two times."""
        middle_s, half_s = 0.5 * (begin_s + end_s), 0.5 * (end_s - begin_s)
        return cls(begin_s, end_s, middle_s + half_s * chebyshev.chebpts1(count))

    def shares(self, times_s: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the share of each instant at some times: Lagrange's polynomials."""
        if self.direct:
            yield from (np.asarray(times_s == at_s, np.float64) for at_s in self.times_s)
            return
        count = len(self.times_s)
        scaled = (2.0 * times_s - self.begin_s - self.end_s) / max(
            self.end_s - self.begin_s, np.finfo(float).tiny
        )
        nodes = chebyshev.chebpts1(count)
        coefficients = chebyshev.chebvander(nodes, count - 1) * (2.0 / count)
        coefficients[:, 0] *= 0.5
        yield from (np.asarray(chebyshev.chebval(scaled, own)) for own in coefficients)

    @property
    def doubtful_s(self) -> float:
        """A time as far as any from instants: what is interpolated there is most in error."""
        if len(self.times_s) == 1:
            return self.begin_s
        middle = len(self.times_s) // 2
        return float(0.5 * (self.times_s[middle - 1] + self.times_s[middle]))


@dataclass(frozen=True, slots=True, eq=False)
class Probes:
    """Points that stand for the surface of all bodies, and the middle of those that move.

    Between two of `marks_s` each goes the way of the polynomial through `places_m`, shape
    (n_marks - 1, NODES, n + 1, 3), the middle last.
    """

    marks_s: np.ndarray
    places_m: np.ndarray

    @classmethod
    def of(cls, bodies: Sequence[BodyInSweep], begin_s: float, end_s: float) -> Probes:
        """The vertices of every body that are outermost, and those that move most.

        Warns of skin that tears.
        """
        marks_s = np.unique(np.concatenate([[begin_s, end_s], *(body.marks_s for body in bodies)]))
        if len(marks_s) > 2 * MOST_INSTANTS:
            raise too_fast()
        rows, stretch = [], 1.0
        for body in bodies:
            some_s = body.marks_s[:: 1 + len(body.marks_s) // _SAMPLED_TIMES]
            times_s = [begin_s, 0.5 * (begin_s + end_s), end_s, *some_s]
            at_m = np.stack([body.vertices_m(time_s, slice(None)) for time_s in times_s])
            away_m = np.linalg.norm(at_m - at_m[0], axis=2).max(axis=0)
            outermost = (at_m[1] @ _DIRECTIONS.T).argmax(axis=0)
            rows.append(np.unique([*outermost, *np.argsort(-away_m, kind="stable")[:_FASTEST]]))
            if body.carried is not None:
                corners_m = at_m[:, body.carried]
                edges_m = np.linalg.norm(corners_m - np.roll(corners_m, 1, axis=2), axis=3)
                longest_m = edges_m.max(axis=2)
                longer = longest_m / np.maximum(longest_m[1], np.finfo(float).tiny)
                stretch = max(stretch, float(np.quantile(longer, 0.99, axis=1).max()))
        if stretch > TORN:
            warn(
                "simulate_moving: a hand bends so far within one sweep that its skin, carried from "
                f"the middle, tears: 1 % of its faces become {stretch:.1f} times as long or "
                "longer; take a shorter sweep or a slower movement"
            )

        def placed_m(time_s: float) -> np.ndarray:
            at_m = [b.vertices_m(time_s, own) for b, own in zip(bodies, rows, strict=True)]
            moving = [m.mean(axis=0) for m, b in zip(at_m, bodies, strict=True) if len(b.marks_s)]
            return np.concatenate([*at_m, [np.mean(moving, axis=0)]])

        nodes = [Piece.between(*ends, NODES).times_s for ends in pairwise(marks_s)]
        return cls(marks_s, np.array([[placed_m(time_s) for time_s in own] for own in nodes]))

    def at_m(self, times_s: np.ndarray, points: slice = slice(None)) -> np.ndarray:
        """Places of points, shape (*times_s.shape, n, 3), metres."""
        flat_s = np.ravel(times_s)
        chosen_m = self.places_m[:, :, points]
        number = np.searchsorted(self.marks_s[1:-1], flat_s, side="right")
        found_m = np.empty((len(flat_s), *chosen_m.shape[2:]))
        for piece in np.unique(number):
            here = number == piece
            own = Piece.between(self.marks_s[piece], self.marks_s[piece + 1], NODES)
            shares = np.stack(list(own.shares(flat_s[here])))
            found_m[here] = np.einsum("kt,kpi->tpi", shares, chosen_m[piece])
        return found_m.reshape(*np.shape(times_s), *found_m.shape[1:])


MIDDLE = slice(-1, None)  # the last point of `Probes`: the middle of what moves


def planned(
    probes: Probes,
    array: AntennaArray,
    waveform: Waveform,
    times_s: np.ndarray,
    tolerance: float,
    overhead_tx: float,
) -> list[Piece]:
    """Return pieces of the time with the least work whose `Piece.error` is within a tolerance.

    Samples are recorded at `times_s` (n_tx, n_rx or 1, n_freq). One simulation costs `overhead_tx`
    and its Tx.
    """
    k = 2 * np.pi * float(waveform.frequencies_hz.max()) / SPEED_OF_LIGHT_M_PER_S
    order = np.argsort(times_s.mean(axis=(1, 2)), kind="stable")

    def windows(parts: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Times of samples and the Tx that record then: from mark to mark, where velocities may
        jump, and from one of `parts` parts of the Tx to the next.
        """
        starts_s = [times_s[tx].min() for tx in np.array_split(order, parts)[1:]]
        cuts_s = np.unique([*probes.marks_s[1:-1], *starts_s])
        number = np.searchsorted(cuts_s, times_s, side="right")
        recorded = (number == own for own in np.unique(number))
        return [(np.unique(times_s[h]), np.flatnonzero(h.any(axis=(1, 2)))) for h in recorded]

    def fewest(samples_s: np.ndarray, tx: np.ndarray) -> Piece:
        """The piece of samples at some times with the fewest instants that are enough."""
        begin_s, end_s = (float(time_s) for time_s in samples_s[[0, -1]])
        direct = Piece(begin_s, end_s, samples_s, direct=True, tx=tx)
        ends_m = []  # of both apertures, with an antenna between them
        for side_m in (array.tx_m[tx], array.rx_m):
            rows = [*side_m.argmin(axis=0), *side_m.argmax(axis=0), len(side_m) // 2]
            ends_m.append(side_m[np.unique(rows)])

        def phases(at_s: np.ndarray) -> np.ndarray:
            """Of echoes (n_times, n_points, n_tx, n_rx), relative to that of the middle."""
            points_m = probes.at_m(at_s)[:, :, None]
            to_tx_m, to_rx_m = (np.linalg.norm(points_m - at_m, axis=3) for at_m in ends_m)
            ways_m = to_tx_m[..., :, None] + to_rx_m[..., None, :]
            return np.asarray(k * (ways_m[:, :-1] - ways_m[:, -1:]))

        # Between two marks a body goes one way and turns by no more than an eighth of a turn. So
        # the phases at a few times tell how far they turn, and nothing between them is missed.
        turned = np.abs(np.diff(phases(np.linspace(begin_s, end_s, 17)), axis=0)).sum(axis=0)
        least = turned.max() / np.pi  # a polynomial has no more zeros than its degree
        error, checked_s, true, piece = np.inf, np.empty(0), np.empty(0), direct
        for count in COUNTS:
            if len(samples_s) <= count:
                return direct
            if count < least:
                continue
            if len(checked_s) < 4 * count:
                checked_s = np.linspace(begin_s, end_s, 16 * count)
                true = np.exp(-1j * phases(checked_s))
            piece = Piece.between(begin_s, end_s, count)
            shares = np.stack(list(piece.shares(checked_s)))
            known = np.exp(-1j * phases(piece.times_s))
            error = float(np.abs(np.tensordot(shares, known, (0, 0)) - true).max())
            if error <= tolerance:
                break
        return replace(piece, tx=tx, error=error)

    best, least = None, np.inf
    for parts in sorted({min(parts, array.n_tx) for parts in PARTS}):
        pieces = [fewest(*window) for window in windows(parts)]
        work = sum(len(piece.times_s) * (overhead_tx + len(piece.tx)) for piece in pieces)
        if best and work > least:
            break  # more parts have more instants
        instants = sum(len(piece.times_s) for piece in pieces)
        if instants <= MOST_INSTANTS and all(piece.error <= tolerance for piece in pieces):
            best, least = pieces, work
    if best is None:
        raise too_fast()
    return best

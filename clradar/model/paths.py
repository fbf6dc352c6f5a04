"""Propagation paths from Tx to Rx by way of the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.model import checks
from clradar.model.record import Record


@dataclass(frozen=True, slots=True, repr=False)
class TraceStatistics(Record):
    """Counts of the samples and rays of one trace; those of several add up.

    Attributes
    ----------
    samples : int
        Points on the surface.
    visible : int
        (sample, Tx) pairs with a free line of sight.
    outgoing : int
        Directions drawn: visible pairs x rays per sample, and one per further bounce; 0 with the
        expected estimator.
    absorbed : int
        Of those, draws that pointed below the geometric face.
    """

    samples: int
    visible: int
    outgoing: int
    absorbed: int

    def __post_init__(self) -> None:
        for name in ("samples", "visible", "outgoing", "absorbed"):
            self._set(**{name: checks.whole(f"TraceStatistics.{name}", getattr(self, name), 0)})
        if self.absorbed > self.outgoing:
            checks.fail(
                "TraceStatistics.absorbed", f"at most outgoing ({self.outgoing})", self.absorbed
            )

    @property
    def absorbed_share(self) -> float:
        """Fraction of outgoing directions that were absorbed."""
        return self.absorbed / self.outgoing if self.outgoing else 0.0

    def __add__(self, other: TraceStatistics) -> TraceStatistics:
        return TraceStatistics(
            self.samples + other.samples,
            self.visible + other.visible,
            self.outgoing + other.outgoing,
            self.absorbed + other.absorbed,
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Paths(Record):
    """One row per reception. Those of `clradar.trace` are sorted by pair, sample, ray and bounce.

    Parameters
    ----------
    tx, rx : array_like, shape (n_paths,), int32
        Indices of the antennas.
    length_m : array_like, shape (n_paths,), float64
        ``|Tx -> p| + ... + |p -> Rx centre|``, positive.
    amplitude : array_like, shape (n_paths,), float32
        Real weight in the phasor sum.
    bounces : array_like, shape (n_paths,), uint8
        Reflections on the mesh, at least 1.
    n_tx, n_rx : int
        Size of the array.
    statistics : TraceStatistics or None
        From the tracer.
    """

    tx: np.ndarray
    rx: np.ndarray
    length_m: np.ndarray
    amplitude: np.ndarray
    bounces: np.ndarray
    n_tx: int
    n_rx: int
    statistics: TraceStatistics | None = None

    def __post_init__(self) -> None:
        self._set(n_tx=checks.whole("Paths.n_tx", self.n_tx, 1))
        self._set(n_rx=checks.whole("Paths.n_rx", self.n_rx, 1))
        if not isinstance(self.statistics, TraceStatistics | None):
            checks.fail(
                "Paths.statistics", "TraceStatistics or None", type(self.statistics).__name__
            )
        count: int | None = None
        columns = (
            ("tx", np.int32),
            ("rx", np.int32),
            ("length_m", np.float64),
            ("amplitude", np.float32),
            ("bounces", np.uint8),
        )
        for name, dtype in columns:
            count = len(self._set_array(name, dtype, (count,), allow_empty=True))
        if not count:
            return
        for name, size in (("tx", self.n_tx), ("rx", self.n_rx)):
            checks.indices(f"Paths.{name}", getattr(self, name), size)
        if self.length_m.min() <= 0:
            checks.fail("Paths.length_m", "positive lengths", f"{self.length_m.min():g}")
        if self.bounces.min() < 1:
            checks.fail("Paths.bounces", "at least one bounce", "0")

    def __len__(self) -> int:
        return len(self.length_m)

    @property
    def pair(self) -> np.ndarray:
        """Index tx * n_rx + rx of each row, shape (n_paths,), int64."""
        return self.tx.astype(np.int64) * self.n_rx + self.rx

"""Captures: the complex samples of one frame, simulated or measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import checks, labelled
from clradar.model.array import AntennaArray
from clradar.model.record import Record
from clradar.model.waveform import Waveform

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Capture(Record):
    """One frame: the complex response of every pair of antennas at every frequency.

    Parameters
    ----------
    data : array_like, shape (n_tx, n_rx, n_freq), complex64
        A path of total length d contributes exp(-j 2 pi f d / c).
    array : AntennaArray
    waveform : Waveform
    meta : mapping
        Provenance, in types of JSON.

    Examples
    --------
    A point at 0.3 m: the slope of the phase is the path length.

    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 64)
    >>> k = 2 * np.pi * waveform.frequencies_hz / 299_792_458
    >>> capture = clradar.Capture([[np.exp(-1j * k * 0.6)]], array, waveform)
    >>> print(f"{-np.polyfit(k, np.unwrap(np.angle(capture.data[0, 0])), 1)[0]:.3f} m")
    0.600 m
    """

    data: np.ndarray
    array: AntennaArray
    waveform: Waveform
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        checks.instance("Capture.array", self.array, AntennaArray)
        checks.instance("Capture.waveform", self.waveform, Waveform)
        shape = (self.array.n_tx, self.array.n_rx, self.waveform.n_freq)
        self._set_array("data", np.complex64, shape, " (tx, rx, freq)")
        self._set(meta=checks.frozen_mapping("Capture.meta", self.meta))

    @property
    def absolute(self) -> bool:
        """Whether the samples are S-parameters, so that images can be read in dBsm.

        So says ``meta["absolute"]``, which the physical estimator sets, and you after a calibration
        of the level (docs/absolute-scale.md).
        """
        return self.meta.get("absolute") is True

    def without_gains(self) -> Capture:
        """Return the capture divided by the gains of its antennas, none of which may be 0."""
        factor = np.ones((1, 1, 1), np.complex128)
        for name, shape in (("tx", (-1, 1, 1)), ("rx", (1, -1, 1))):
            gain = getattr(self.array, f"{name}_gain")
            if gain is None:
                continue
            if not gain.all():
                expected = "no gain of 0, of which nothing can be divided out"
                at = int(np.flatnonzero(gain == 0)[0])
                checks.fail(f"Capture.array.{name}_gain", expected, f"0 at index {at}")
            factor = factor * gain.reshape(shape)
        if not self.array.has_gains:
            return self
        return replace(self, data=self.data / factor, array=self.array.without_gains())

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self._own_array(dtype, copy)

    def to_xarray(self) -> xarray.Dataset:
        """Return `capture` along tx, rx and frequency_hz, with antennas, units and `meta`."""
        return labelled.capture_dataset(self)

    def rcs_dbsm(self, at_m: Any) -> np.ndarray:
        """Return the radar cross section that each sample tells of all around a point `at_m`.

        Unlike an image it holds for targets of any size, about their nearest point.

        Returns
        -------
        ndarray, shape (n_tx, n_rx, n_freq), float64, dBsm
            ``4 pi R_t^2 R_r^2 |u|^2``, u as in docs/absolute-scale.md; -inf where a sample is 0,
            NaN where an antenna does not look.
        """
        if not self.absolute:
            checks.fail("Capture.meta", "'absolute': True, for S-parameters", "a relative scale")
        point_m = checks.read_only("Capture.rcs_dbsm: at_m", at_m, np.float64, (3,))
        sides = []
        for side in self.array.sides:
            length_m, field = (values[0] for values in side.towards(point_m[None]))
            if not length_m.all():
                checks.fail("Capture.rcs_dbsm: at_m", "a point away from antennas", "one at them")
            sides.append(np.abs(field) / length_m)
        wavelength_m = SPEED_OF_LIGHT_M_PER_S / self.waveform.frequencies_hz
        of_square_metre = np.einsum("t,r,n->trn", *sides, wavelength_m) / (4 * np.pi) ** 1.5
        with np.errstate(divide="ignore", invalid="ignore"):
            level_db = 20 * np.log10(np.abs(self.data) / of_square_metre)
        return np.where(of_square_metre > 0, level_db, np.nan)


def check_same_radar(field: str, capture: Capture, reference: Capture) -> None:
    """Raise a `ModelError` unless both captures have the same antennas and frequencies."""
    if not capture.array.same_positions(reference.array):
        words = [
            f"'{a.name}', {a.n_tx} Tx and {a.n_rx} Rx" for a in (reference.array, capture.array)
        ]
        checks.fail(field, f"the same antennas ({words[0]})", f"others ({words[1]})")
    if not capture.waveform.same_frequencies(reference.waveform):
        words = [
            f"{w.n_freq} from {w.frequencies_hz[0] / 1e9:g} to {w.frequencies_hz[-1] / 1e9:g} GHz"
            for w in (reference.waveform, capture.waveform)
        ]
        checks.fail(field, f"the same frequencies ({words[0]})", f"others ({words[1]})")

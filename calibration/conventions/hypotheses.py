"""The sixteen convention hypotheses, and the involution that undoes each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from clradar.errors import ModelError
from clradar.model import Capture, checks

MIRROR_X = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True, order=True)
class Hypothesis:
    """How the convention of a file differs from that of clradar.

    Each of the four changes is its own inverse and they commute, so applying a hypothesis twice
    restores the capture: see `apply_convention`.

    Attributes
    ----------
    swapped : bool
        The data is [rx, tx, freq], although its axes are called [tx, rx, freq]. The antenna
        positions are right.
    conjugated : bool
        A path of length d contributes exp(+j 2 pi f d / c) instead of exp(-j 2 pi f d / c).
    reversed : bool
        Along the frequency axis the data runs from the highest frequency to the lowest, although
        the list of frequencies ascends.
    mirrored : bool
        The antenna positions are in a frame whose x axis points the other way: an antenna listed
        at x is at -x.

    Examples
    --------
    >>> from clradar import calibration
    >>> calibration.Hypothesis(swapped=True, mirrored=True).label
    'swapped, mirrored'
    """

    swapped: bool = False
    conjugated: bool = False
    reversed: bool = False
    mirrored: bool = False

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not isinstance(getattr(self, name), bool | np.bool_):
                checks.fail(f"Hypothesis.{name}", "True or False", repr(getattr(self, name)))

    @property
    def changes(self) -> int:
        """How many of the four differ from clradar's convention, 0 to 4."""
        return self.swapped + self.conjugated + self.reversed + self.mirrored

    @property
    def label(self) -> str:
        """The names of its changes, such as "swapped, mirrored"; "as it is" without any."""
        return ", ".join(n for n in self.__slots__ if getattr(self, n)) or "as it is"

    def without_mirror(self) -> Hypothesis:
        return replace(self, mirrored=False)


HYPOTHESES = tuple(Hypothesis(*flags) for flags in product((False, True), repeat=4))
"""All sixteen, the unchanged convention first."""


def apply_convention(
    capture: Capture, hypothesis: Hypothesis, *, position_scale: float = 1.0
) -> Capture:
    """Apply the changes of a hypothesis to a capture, or undo them: each is its own inverse.

    Parameters
    ----------
    capture : Capture
    hypothesis : Hypothesis
    position_scale : float
        Factor for all antenna positions, for a file in another unit: `Diagnosis.position_scale`.

    Returns
    -------
    Capture
        Same waveform; where anything changes, the label of the hypothesis is appended to the list
        ``meta["conventions_applied"]``.

    Raises
    ------
    ModelError
        Tx and Rx cannot be swapped because their numbers differ; a scale that is not positive.

    Examples
    --------
    >>> import clradar
    >>> from clradar import calibration
    >>> array = clradar.AntennaArray([[0.01, 0, 0]], [[0, 0, 0]])
    >>> capture = clradar.Capture([[[1j]]], array, clradar.Waveform([77e9]))
    >>> other = calibration.Hypothesis(conjugated=True, mirrored=True)
    >>> fixed = calibration.apply_convention(capture, other)
    >>> print(fixed.data[0, 0, 0], fixed.array.tx_m[0, 0], fixed.meta["conventions_applied"])
    -1j -0.01 ['conjugated, mirrored']
    """
    checks.instance("apply_convention: capture", capture, Capture)
    checks.instance("apply_convention: hypothesis", hypothesis, Hypothesis)
    position_scale = checks.positive("apply_convention: position_scale", position_scale)
    labels = [] if position_scale == 1 else [f"positions times {position_scale:g}"]
    labels += [hypothesis.label] if hypothesis.changes else []
    if not labels:
        return capture
    array, data = capture.array, capture.data
    if position_scale != 1:
        tx_m, rx_m = array.tx_m * position_scale, array.rx_m * position_scale
        array = replace(array, tx_m=tx_m, rx_m=rx_m)
    if hypothesis.swapped:
        if array.n_tx != array.n_rx:
            raise ModelError(
                "apply_convention: expected as many Tx as Rx to swap the axes of the data, got "
                f"{array.n_tx} Tx and {array.n_rx} Rx"
            )
        data = data.transpose(1, 0, 2)
    if hypothesis.conjugated:
        data = data.conj()
    if hypothesis.reversed:
        data = data[..., ::-1]
    if hypothesis.mirrored:
        array = replace(array, tx_m=array.tx_m * MIRROR_X, rx_m=array.rx_m * MIRROR_X)
    before = capture.meta.get("conventions_applied", [])
    meta = {**capture.meta, "conventions_applied": [*before, *labels]}
    return Capture(np.ascontiguousarray(data), array, capture.waveform, meta)

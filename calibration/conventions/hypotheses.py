"""The ways in which a file's convention can differ from ours, and how each is undone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from clradar.errors import ModelError
from clradar.model import AntennaArray, Capture, checks

MIRROR_X = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True, order=True)
class Hypothesis:
    """What may have been done to a capture, seen from our convention, when its file was written.

    Each of the four is its own inverse and they commute, so whatever was done is undone by doing it
    again: see `apply_convention`.

    Attributes
    ----------
    swapped : bool
        The data is [rx, tx, freq], although its axes are called [tx, rx, freq]. The lists of
        antenna positions are right.
    conjugated : bool
        A path of length d contributes exp(+j 2 pi f d / c) instead of exp(-j 2 pi f d / c).
    reversed : bool
        Along the frequency axis the data runs from the highest frequency to the lowest, although
        the list of frequencies ascends.
    mirrored : bool
        The antenna positions are in a frame whose x points the other way: the antenna that is said
        to be at x is at -x.
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
        """How many of the four differ from our convention, 0 to 4."""
        return self.swapped + self.conjugated + self.reversed + self.mirrored

    @property
    def label(self) -> str:
        """The hypothesis in a few words, such as "swapped, mirrored"; "as it is" without any."""
        return ", ".join(n for n in self.__slots__ if getattr(self, n)) or "as it is"

    def without_mirror(self) -> Hypothesis:
        return replace(self, mirrored=False)


HYPOTHESES = tuple(Hypothesis(*flags) for flags in product((False, True), repeat=4))
"""All sixteen, as they are first."""


def apply_convention(capture: Capture, hypothesis: Hypothesis) -> Capture:
    """Return the capture with what `hypothesis` says done to it, or undone: it is the same.

    Parameters
    ----------
    capture : Capture
    hypothesis : Hypothesis

    Returns
    -------
    Capture
        Same waveform. `meta` is the capture's, with the hypothesis added to the list
        ``meta["conventions_applied"]`` where it changes anything.

    Raises
    ------
    ModelError
        Tx and Rx cannot be swapped because their numbers differ.
    """
    checks.instance("apply_convention: capture", capture, Capture)
    checks.instance("apply_convention: hypothesis", hypothesis, Hypothesis)
    if not hypothesis.changes:
        return capture
    array, data = capture.array, capture.data
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
        array = AntennaArray(array.tx_m * MIRROR_X, array.rx_m * MIRROR_X, array.name)
    before = capture.meta.get("conventions_applied", [])
    meta = {**capture.meta, "conventions_applied": [*before, hypothesis.label]}
    return Capture(np.ascontiguousarray(data), array, capture.waveform, meta)

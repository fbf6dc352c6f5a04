"""Frequencies by a layout, in hertz."""

from __future__ import annotations

import numpy as np

from clradar.constants import MAX_FREQUENCIES, PLAUSIBLE_HZ
from clradar.files.failures import clean, fail
from measurement_io.layouts.container import Container
from measurement_io.layouts.layout import FREQUENCY_UNITS_HZ, FrequencyLayout
from measurement_io.layouts.real_values import real_list, real_number


def read_frequencies(container: Container, layout: FrequencyLayout) -> tuple[np.ndarray, bool]:
    """Return the frequencies and whether the file has them descending.

    Returns
    -------
    ndarray, shape (n_freq,), float64, hertz
        Ascending.
    bool
        True where they, and so the data, have to be reversed.

    Raises
    ------
    MeasurementError
        Not strictly ascending or descending, not plausible in the layout's unit.
    """
    path = container.path
    frequency_hz = _as_described(container, layout)
    low_hz, high_hz = PLAUSIBLE_HZ
    outside = ~((frequency_hz >= low_hz) & (frequency_hz <= high_hz))
    if outside.any():
        fail(
            path,
            f"frequencies between {low_hz:g} and {high_hz:g} Hz",
            f"{frequency_hz[outside][0]:g} Hz, read in {layout.unit}; is that the file's unit?",
        )
    steps = np.diff(frequency_hz)
    if (steps > 0).all():
        return frequency_hz, False
    if (steps < 0).all():
        return frequency_hz[::-1], True
    wrong = steps <= 0 if steps[0] > 0 else steps >= 0
    at = int(np.argmax(wrong))
    fail(
        path,
        "frequencies that ascend or descend",
        f"{frequency_hz[at]:.12g}, then {frequency_hz[at + 1]:.12g} Hz at {at}, {at + 1}",
    )


def _as_described(container: Container, layout: FrequencyLayout) -> np.ndarray:
    unit_hz = FREQUENCY_UNITS_HZ[layout.unit]
    if layout.key is not None:
        return real_list(container, layout.key, "the frequencies") * unit_hz
    if layout.values is not None:
        return np.array(layout.values) * unit_hz
    assert layout.start is not None
    assert layout.points is not None
    start = real_number(container, layout.start, "the first frequency")
    points = real_number(container, layout.points, "the number of frequencies")
    if points != int(points) or not 1 <= points <= MAX_FREQUENCIES:
        fail(container.path, "a whole number of frequencies from 1", clean(points))
    count = int(points)
    if layout.step is not None:
        step = real_number(container, layout.step, "the frequency step")
        return (start + step * np.arange(count)) * unit_hz
    assert layout.stop is not None
    stop = real_number(container, layout.stop, "the last frequency")
    if count == 1 and start != stop:
        fail(container.path, "more than one frequency from start to stop", "1")
    return np.linspace(start * unit_hz, stop * unit_hz, count)

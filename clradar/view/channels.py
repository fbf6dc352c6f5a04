"""Channel data of a capture as drawings: all pairs, and one over frequency and range."""

from __future__ import annotations

import numpy as np

from clradar.model import Capture
from clradar.model.range_profile import hann, profile_transform
from clradar.view.framed import Axis, curves, framed, spanning
from clradar.view.pictures import amplitude_bar, amplitude_pixels

OVERVIEW_DB = 40.0
"""Range of the overview of all pairs."""

SHOWN_DB = 60.0
"""What is this far below the maximum of a curve is drawn at its lower edge."""

PROFILE_PLACES = 600
"""Of a range profile, at most: more than a panel has pixels."""


def pair_drawings(capture: Capture, tx: int, rx: int) -> tuple[str, str, str, str]:
    """Return a drawing of all pairs, and of one its magnitude, phase and range profile, as SVG.

    Parameters
    ----------
    capture : Capture
    tx, rx : int
        Of the pair; the last one where there are fewer.
    """
    tx, rx = min(tx, capture.array.n_tx - 1), min(rx, capture.array.n_rx - 1)
    waveform = capture.waveform
    samples = capture.data[tx, rx].astype(np.complex128)
    level_db = _level_db(samples)
    turns = np.unwrap(np.angle(samples)) / (2 * np.pi)
    place_m = np.linspace(0.0, waveform.unambiguous_range_m, PROFILE_PLACES)
    weights = hann(waveform.n_freq)
    profile_db = _level_db(samples @ profile_transform(waveform, weights, 2 * place_m))
    ghz = 1e-9 * waveform.frequencies_hz
    frequency = _axis("frequency (GHz)", ghz)
    place = _axis("half the path (mm)", 1e3 * place_m)
    pair = f"Tx {tx}, Rx {rx}"
    return (
        _overview(capture, tx, rx),
        curves(f"{pair}: magnitude", frequency, _levels(level_db), ghz, level_db),
        curves(f"{pair}: phase", frequency, spanning("turns", turns), ghz, turns),
        curves(f"{pair}: range profile", place, _levels(profile_db), 1e3 * place_m, profile_db),
    )


def _overview(capture: Capture, tx: int, rx: int) -> str:
    n_tx, n_rx, _ = capture.data.shape
    power = np.einsum("trf,trf->tr", capture.data.real, capture.data.real)
    power += np.einsum("trf,trf->tr", capture.data.imag, capture.data.imag)
    rms = np.sqrt(power / capture.waveform.n_freq)
    pixels = amplitude_pixels(rms, float(rms.max()), OVERVIEW_DB)
    across, up = Axis("Rx", -0.5, n_rx - 0.5), Axis("Tx", -0.5, n_tx - 0.5)
    return framed(
        "RMS over frequency", pixels[::-1], across, up, amplitude_bar(OVERVIEW_DB), marked=(rx, tx)
    )


def _axis(name: str, values: np.ndarray) -> Axis:
    first, last = float(values[0]), float(values[-1])
    return Axis(name, first, last) if last > first else Axis(name, first - 0.5, first + 0.5)


def _level_db(samples: np.ndarray) -> np.ndarray:
    magnitude = np.abs(samples)
    floor = float(magnitude.max()) * 10 ** (-SHOWN_DB / 20) or 1e-30
    level_db: np.ndarray = 20 * np.log10(np.maximum(magnitude, floor))
    return level_db


def _levels(level_db: np.ndarray) -> Axis:
    return spanning("dB", level_db)

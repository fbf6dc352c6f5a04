"""Range gating by a Wiener filter over frequency, against coupling, walls and mirror images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, Waveform, checks

EDGE_CELLS = 4.0
"""Default width of the transition bands in resolution cells c / 2B: 6 cm for 10 GHz."""
CLUTTER_DB = 40.0
EDGE_WEIGHT = 0.03
"""Weight of the transition bands. With less, echoes in them can grow (fourfold at 0.001)."""
NOISE_POWER = 1e-3
"""Power of the noise relative to the scene, per delay: keeps the gate from amplifying noise."""
PROBES_PER_CELL = 8


@dataclass(frozen=True, slots=True, eq=False)
class Gate:
    """A linear map over the frequencies of a pair that keeps the echoes of a range window.

    Attributes
    ----------
    matrix : numpy.ndarray, shape (n_freq, n_freq), complex128
        The gated samples of a pair are `matrix @ s[tx, rx]`.
    near_m, far_m, edge_m : float, metres
        The window, in half path length, and the width of each transition band outside it.
    clutter_db : float, dB
    passband_db : float, dB
        Smallest gain of an echo in the window, ``|<s, G s>| / <s, s>``.
    rejection_db : float, dB
        Smallest suppression of the RMS of an echo beyond the transition bands.

    Examples
    --------
    >>> import clradar
    >>> from clradar import calibration
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
    >>> window = calibration.gate(waveform, near_m=0.1, far_m=0.2)
    >>> window.matrix.shape, round(window.edge_m, 3)
    ((32, 32), 0.06)
    """

    matrix: np.ndarray
    near_m: float
    far_m: float
    edge_m: float
    clutter_db: float
    passband_db: float
    rejection_db: float

    def record(self) -> dict[str, float]:
        """Everything but the matrix, in types that JSON has."""
        names = ("near_m", "far_m", "edge_m", "clutter_db", "passband_db", "rejection_db")
        return {name: getattr(self, name) for name in names}


def range_gate(
    capture: Capture,
    *,
    near_m: float,
    far_m: float,
    edge_m: float | None = None,
    clutter_db: float = CLUTTER_DB,
) -> Capture:
    """Remove the echoes from outside a range window.

    Range is half of the path length, ``(|p - tx| + |p - rx|) / 2``, the same window for every pair.
    The direct coupling, whose path is ``|tx - rx|``, lies below half of the aperture's diagonal
    (0.1 m for the 14 cm imager); a point (x, y, z) lies between z and the distance from the
    farthest antenna.

    Parameters
    ----------
    capture : Capture
    near_m, far_m : float, metres
        Echoes from near_m to far_m are kept.
    edge_m : float, metres, optional
        Echoes nearer than near_m - edge_m and farther than far_m + edge_m are rejected; those
        between may be attenuated by any amount. Default: four resolution cells c / 2B, 60 mm for
        10 GHz.
    clutter_db : float, dB
        Power of the echoes outside relative to those inside, roughly: more rejects better, and
        distorts the window more.

    Returns
    -------
    Capture
        `meta["range_gate"]` holds the window, `passband_db` and `rejection_db`: see `Gate`.

    Raises
    ------
    ModelError
        A single frequency, a window beyond the unambiguous range c / 2 df, or edges that leave
        nothing to reject.

    See Also
    --------
    gate : the map itself, and its equation.

    Examples
    --------
    An echo at 0.15 m is kept, one at 0.4 m is rejected:

    >>> import clradar, numpy as np
    >>> from clradar import calibration
    >>> from clradar import reference
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
    >>> for z_m in (0.15, 0.4):
    ...     echo = reference.point_targets(array, waveform, [[0, 0, z_m]], [1.0])
    ...     gated = calibration.range_gate(echo, near_m=0.1, far_m=0.2)
    ...     gain = np.linalg.norm(gated.data) / np.linalg.norm(echo.data)
    ...     print(f"{20 * np.log10(gain):.1f} dB")
    -0.4 dB
    -67.8 dB
    """
    checks.instance("range_gate: capture", capture, Capture)
    found = gate(capture.waveform, near_m=near_m, far_m=far_m, edge_m=edge_m, clutter_db=clutter_db)
    data = np.empty(capture.data.shape, np.complex64)
    for out, row in zip(data, capture.data, strict=True):
        out[:] = row.astype(np.complex128) @ found.matrix.T
    data.flags.writeable = False
    meta = {**capture.meta, "range_gate": found.record()}
    return Capture(data, capture.array, capture.waveform, meta)


def gate(
    waveform: Waveform,
    *,
    near_m: float,
    far_m: float,
    edge_m: float | None = None,
    clutter_db: float = CLUTTER_DB,
) -> Gate:
    """Compute the linear map that `range_gate` applies.

    Parameters and errors are those of `range_gate`.

    Returns
    -------
    Gate

    Notes
    -----
    A window over the inverse Fourier transform treats the band as one period of a periodic signal,
    and so mixes its two ends. Instead, this is the linear map G with the least mean square error
    for echoes of every path length d within one period D = c / df::

        G = argmin  int p(d) |G a(d) - w(d) a(d)|^2 dd + eps |G|^2,  a(d)_n = exp(-j 2 pi f_n d / c)
          = [int p w a a^H] [int p a a^H + eps I]^-1

    Here p = 1, w = 1 in the window, w = 0 and p = 10^(clutter_db / 10) outside, and p = 0.03,
    w = 1/2 in the transition bands: the Wiener filter for clutter of that power. Every integral has
    a closed form (a sinc), so the frequency steps may differ; D is then that of the largest. Delays
    below zero are the end of the period, so mirror images from IQ imbalance are rejected as well.

    Examples
    --------
    >>> import clradar
    >>> from clradar import calibration
    >>> window = calibration.gate(clradar.Waveform.sfcw(72e9, 82e9, 32), near_m=0.1, far_m=0.2)
    >>> round(window.passband_db, 1), round(window.rejection_db)
    (-0.5, 51)
    """
    checks.instance("range_gate: waveform", waveform, Waveform)
    if waveform.n_freq < 2:
        checks.fail("range_gate: waveform", "two frequencies or more", "one, which has no range")
    near = checks.real("range_gate: near_m", near_m)
    far = checks.real("range_gate: far_m", far_m)
    if not 0 <= near < far:
        checks.fail("range_gate", "0 <= near_m < far_m", f"{near:g} and {far:g}")
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * waveform.span_hz)
    edge = EDGE_CELLS * cell_m if edge_m is None else checks.real("range_gate: edge_m", edge_m)
    if edge < 0:
        checks.fail("range_gate: edge_m", "a width that is not negative", repr(edge_m))
    clutter = checks.real("range_gate: clutter_db", clutter_db)
    if not 0 <= clutter <= 100:
        checks.fail("range_gate: clutter_db", "0 to 100 dB", repr(clutter_db))
    period_m = SPEED_OF_LIGHT_M_PER_S / (2 * float(np.diff(waveform.frequencies_hz).max()))
    if far > period_m:
        checks.fail(
            "range_gate: far_m",
            f"at most {period_m:.4g} m, where ranges start to repeat with these frequency steps",
            f"{far:g} m",
        )
    if far - near + 2 * edge >= period_m:
        checks.fail(
            "range_gate",
            f"a window with its edges shorter than the unambiguous {period_m:.4g} m",
            f"{far - near:g} m and two edges of {edge:g} m: nothing is left to reject",
        )

    offsets_hz = waveform.frequencies_hz - waveform.center_hz
    inside = _gram(offsets_hz, near, far, period_m)
    edges = _gram(offsets_hz, near - edge, near, period_m)
    edges += _gram(offsets_hz, far, far + edge, period_m)
    outside = _gram(offsets_hz, far + edge, period_m + near - edge, period_m)
    wanted = inside + EDGE_WEIGHT / 2 * edges
    whole = inside + EDGE_WEIGHT * edges + 10 ** (clutter / 10) * outside
    whole += NOISE_POWER * np.eye(waveform.n_freq)
    matrix = np.linalg.solve(whole, wanted).conj().T  # both are Hermitian
    matrix.flags.writeable = False

    echoes, kept = _responses(matrix, offsets_hz, near, far)
    passband_db = _amplitude_db(np.abs((echoes.conj() * kept).mean(axis=0)).min())
    _, left = _responses(matrix, offsets_hz, far + edge, period_m + near - edge)
    rejection_db = -_amplitude_db(np.sqrt((np.abs(left) ** 2).mean(axis=0)).max())
    return Gate(matrix, near, far, edge, clutter, passband_db, rejection_db)


def _gram(offsets_hz: np.ndarray, low_m: float, high_m: float, period_m: float) -> np.ndarray:
    """Integral of a a^H over half path lengths, in periods, shape (n_freq, n_freq)."""
    difference = 2 * (offsets_hz[:, None] - offsets_hz) / SPEED_OF_LIGHT_M_PER_S
    width_m, middle_m = high_m - low_m, (high_m + low_m) / 2
    phasors = np.exp(-2j * np.pi * difference * middle_m)
    return width_m / period_m * np.sinc(difference * width_m) * phasors


def _responses(
    matrix: np.ndarray, offsets_hz: np.ndarray, low_m: float, high_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Echoes an eighth of a resolution cell apart, before and after the gate, (n_freq, n)."""
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * float(offsets_hz[-1] - offsets_hz[0]))
    count = int(np.ceil(PROBES_PER_CELL * (high_m - low_m) / cell_m)) + 2
    range_m = np.linspace(low_m, high_m, count)
    echoes = np.exp(-2j * np.pi * (2 / SPEED_OF_LIGHT_M_PER_S * np.outer(offsets_hz, range_m)))
    return echoes, matrix @ echoes


def _amplitude_db(amplitude: Any) -> float:
    return float(20 * np.log10(max(float(amplitude), 1e-15)))

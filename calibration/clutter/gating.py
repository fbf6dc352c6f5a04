"""Keep the echoes of a window of range, and reject the others: coupling, walls, mirror images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Capture, Waveform, checks

EDGE_CELLS = 4.0
"""Width of the gate's edges in resolution cells c / 2B, if none is given: 6 cm for 10 GHz."""
CLUTTER_DB = 40.0
EDGE_WEIGHT = 0.03
"""How much the edges count. With less, what lies in them can grow (fourfold at 0.001)."""
NOISE = 1e-3
"""Power of the noise against that of the scene, per delay: keeps the gate from amplifying it."""
PROBES_PER_CELL = 8


@dataclass(frozen=True, slots=True, eq=False)
class Gate:
    """A linear map of the samples over frequency that keeps the echoes of a window of range.

    Attributes
    ----------
    matrix : numpy.ndarray, shape (n_freq, n_freq), complex128
        The gated samples of a pair are `matrix @ s[tx, rx]`.
    near_m, far_m, edge_m : float, metres
        The window, in half path length, and the width of each edge outside it.
    clutter_db : float, dB
    passband_db : float, dB
        Least amplitude, over the window, to which an echo is changed: |<s, G s>| / <s, s>.
    rejection_db : float, dB
        Least suppression of the RMS of an echo beyond the edges.
    """

    matrix: np.ndarray
    near_m: float
    far_m: float
    edge_m: float
    clutter_db: float
    passband_db: float
    rejection_db: float

    def record(self) -> dict[str, float]:
        """Return everything but the matrix, in types that JSON knows."""
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
    """Return the capture without the echoes from outside a window of range.

    Range is half of the path length, (|p - tx| + |p - rx|) / 2, the same window for every pair. The
    direct coupling, whose path is |tx - rx|, lies below half of the aperture's diagonal (0.1 m for
    the 14 cm imager); a point (x, y, z) lies between z and the distance from the farthest antenna.

    Parameters
    ----------
    capture : Capture
    near_m, far_m : float, metres
        Echoes from near_m to far_m are kept.
    edge_m : float, metres, optional
        Echoes nearer than near_m - edge_m and farther than far_m + edge_m are rejected; between,
        anything may happen. Four resolution cells c / 2B if not given: 60 mm for 10 GHz.
    clutter_db : float, dB
        How much stronger the echoes outside are than those inside, about: more rejects better, and
        changes what is inside more.

    Returns
    -------
    Capture
        `meta["range_gate"]` holds the window, `passband_db` and `rejection_db`: see `Gate`.

    Raises
    ------
    ModelError
        No range, a window beyond the unambiguous range c / 2 df, or edges that leave nothing to
        reject.

    See Also
    --------
    gate : the map itself, and its equation.
    """
    checks.instance("range_gate: capture", capture, Capture)
    found = gate(capture.waveform, near_m=near_m, far_m=far_m, edge_m=edge_m, clutter_db=clutter_db)
    data = np.empty(capture.data.shape, np.complex64)
    turned = found.matrix.T
    for out, row in zip(data, capture.data, strict=True):
        out[:] = row.astype(np.complex128) @ turned
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
    """Return the map that `range_gate` applies.

    Parameters and errors are those of `range_gate`.

    Notes
    -----
    A window of weights over the inverse Fourier transform takes the band for one period of
    something endless, and so mixes its two ends. Instead, this is the linear map G with the least
    mean square error for echoes of every path length d within one period D = c / df,

        G = argmin  int p(d) |G a(d) - w(d) a(d)|^2 dd + eps |G|^2,  a(d)_n = exp(-j 2 pi f_n d / c)
          = [int p w a a^H] [int p a a^H + eps I]^-1,

    with p = 1, w = 1 in the window, w = 0 and p = 10^(clutter_db / 10) outside, and p = 0.03,
    w = 1/2 in the edges, whose echoes may go either way: the Wiener filter for clutter that much
    stronger than the scene. Every integral has a closed form (a sinc), so the steps between
    frequencies may differ; D is then that of the largest. Delays below zero are the end of the
    period, so mirror images from IQ imbalance are rejected as well.
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
    whole += NOISE * np.eye(waveform.n_freq)
    matrix = np.linalg.solve(whole, wanted).conj().T  # both are Hermitian
    matrix.flags.writeable = False
    passband_db, rejection_db = _measured(matrix, offsets_hz, near, far, edge, period_m)
    return Gate(matrix, near, far, edge, clutter, passband_db, rejection_db)


def _gram(offsets_hz: np.ndarray, low_m: float, high_m: float, period_m: float) -> np.ndarray:
    """Return the integral of a a^H over half paths, in periods, shape (n_freq, n_freq)."""
    difference = 2 * (offsets_hz[:, None] - offsets_hz) / SPEED_OF_LIGHT_M_PER_S
    width_m, middle_m = high_m - low_m, (high_m + low_m) / 2
    turns = np.exp(-2j * np.pi * difference * middle_m)
    return width_m / period_m * np.sinc(difference * width_m) * turns


def _measured(
    matrix: np.ndarray,
    offsets_hz: np.ndarray,
    near_m: float,
    far_m: float,
    edge_m: float,
    period_m: float,
) -> tuple[float, float]:
    """Return `passband_db` and `rejection_db` of Gate, from echoes an eighth of a cell apart."""
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * float(offsets_hz[-1] - offsets_hz[0]))

    def response(low_m: float, high_m: float) -> tuple[np.ndarray, np.ndarray]:
        count = int(np.ceil(PROBES_PER_CELL * (high_m - low_m) / cell_m)) + 2
        range_m = np.linspace(low_m, high_m, count)
        turns = 2 / SPEED_OF_LIGHT_M_PER_S * np.outer(offsets_hz, range_m)
        echoes = np.exp(-2j * np.pi * turns)
        return echoes, matrix @ echoes

    echoes, kept = response(near_m, far_m)
    passband = np.abs((echoes.conj() * kept).mean(axis=0)).min()
    _, left = response(far_m + edge_m, period_m + near_m - edge_m)
    rejection = np.sqrt((np.abs(left) ** 2).mean(axis=0)).max()
    return _db(passband), -_db(rejection)


def _db(amplitude: Any) -> float:
    return float(20 * np.log10(max(float(amplitude), 1e-15)))

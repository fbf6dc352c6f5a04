"""Fit of channel responses and target pose (docs/channel-calibration.md): variable projection.

Around a trial, mean and slope over frequency of each pair are sufficient. For any pose near it the
best channels follow in closed form, gains as a rank-one matrix, delays as sums of a Tx term and an
Rx term: what is left is a least-squares problem of three numbers, for scipy. Its solution is the
next trial.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares

from calibration.channels.targets import Echo, Target
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import CalibrationError
from clradar.jobs.outcome import silent
from clradar.model import AntennaArray
from clradar.model.progress import Progress

TUKEY_CUTOFF = 4.685 / np.sqrt(2.0)  # for magnitudes of complex residuals with mean square 1
LEAST_WEIGHT = 1e-4  # of outliers over others: a channel of outliers alone needs a solution, too
DELAY_FLOOR_S = 1e-13  # smallest prior spread of the delays: 0.03 mm of path
NOISE_FLOOR = 1e-5  # smallest noise over the echo: far above the rounding of complex64
STEP_TOLERANCE = 0.02  # converged when no parameter moves by more of its standard deviation, ...
LEAST_STEP = 1e-5  # ... or than this: radians, nepers, pose tolerances
CAPTURE_RANGE = 3.0  # most distance of the pose from its nominal one, in tolerances
MOST_STEPS = 60
_DIFFERENCE = 1e-4  # step of the derivative by the pose, in units of the tolerance
_SCAN_STEPS = 8  # of the search for delays, per resolution cell 1 / bandwidth
_ALTERNATIONS = 50  # of the gains of Tx and Rx


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The samples of a capture, shape (n_tx, n_rx, n_freq)."""

    data: np.ndarray
    frequencies_hz: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        """Of the frequencies, whose means are sums."""
        return np.full(self.frequencies_hz.size, 1.0 / self.frequencies_hz.size)

    @property
    def reference_hz(self) -> float:
        return float(self.weight @ self.frequencies_hz)

    @property
    def offset_rad_per_s(self) -> np.ndarray:
        """2 pi (f - reference), whose sum is zero."""
        return np.asarray(2 * np.pi * (self.frequencies_hz - self.reference_hz))

    @property
    def spread_rad_per_s(self) -> float:
        """Root mean square of `offset_rad_per_s`."""
        return float(np.sqrt(self.weight @ self.offset_rad_per_s**2))

    def power(self) -> np.ndarray:
        """Power of one sample of each pair, shape (n_tx, n_rx)."""
        return np.stack([energy(row.astype(np.complex128)) / row.shape[1] for row in self.data])

    def flattened(self, length_m: np.ndarray, delay_s: np.ndarray) -> Iterator[np.ndarray]:
        """Yield per Tx, shape (n_rx, n_freq), the samples without paths and delays."""
        rad_per_m = 2 * np.pi / SPEED_OF_LIGHT_M_PER_S * self.frequencies_hz
        for i, row in enumerate(self.data):
            late = delay_s[i] + delay_s[len(self.data) :]
            phase = length_m[i][:, None] * rad_per_m + late[:, None] * self.offset_rad_per_s
            yield row * np.exp(1j * phase)


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Statistics of each pair, shape (n_tx, n_rx), after a trial's phases are removed."""

    mean: np.ndarray
    slope: np.ndarray  # projection on nu / rms(nu)
    model: np.ndarray  # amplitude of the trial
    scatter: np.ndarray  # power of one sample beside mean and slope, which is noise
    total: np.ndarray  # power of one sample beside the trial


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFit:
    """The converged fit, with the target in its estimated pose; channels are Tx and then Rx."""

    gain: np.ndarray
    delay_s: np.ndarray
    phase_std_rad: np.ndarray  # given the pose
    target: Target
    echo: Echo
    pairs: Pairs
    noise: np.ndarray  # of one sample, shape (n_tx, n_rx), from the channels'
    covariance: np.ndarray  # of the pose in its units


def energy(spectra: np.ndarray) -> np.ndarray:
    """Of each row."""
    return np.asarray((spectra.real**2 + spectra.imag**2).sum(axis=1))


def start(samples: Samples, echo: Echo, search_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Gains and delays of all Tx and Rx to begin with, dead ones too, of a target in its place.

    The delay of a channel is the maximum of the delay profiles of its pairs, summed in power; gains
    are the best rank-one approximation of the sum over frequency.
    """
    n_tx, n_rx, _ = samples.data.shape
    # Both ends, and a step a little finer than 1 / `_SCAN_STEPS` of a cell.
    band_hz = float(np.ptp(samples.frequencies_hz))
    half = int(np.ceil(_SCAN_STEPS * search_s * band_hz))
    delays_s = np.linspace(-search_s, search_s, 2 * half + 1)
    steer = samples.weight[:, None] * np.exp(1j * samples.offset_rad_per_s[:, None] * delays_s)
    tx_power, rx_power = np.zeros((n_tx, delays_s.size)), np.zeros((n_rx, delays_s.size))
    rows = samples.flattened(echo.length_m, np.zeros(n_tx + n_rx))
    for i, row in enumerate(rows):
        power = np.abs(row @ steer) ** 2 * echo.seen[i][:, None]
        tx_power[i] = power.sum(axis=0)
        rx_power += power
    common = _peaks(delays_s, tx_power.sum(axis=0)[None, :])[0]
    if abs(common) > search_s - 0.5 / band_hz / _SCAN_STEPS:
        reach_mm = 500.0 * search_s * SPEED_OF_LIGHT_M_PER_S
        raise CalibrationError(
            "estimate_channels: expected an echo of the target within "
            f"{reach_mm:.0f} mm of its range, found a stronger one at the end of that window"
        )
    # A Tx profile peaks at its delay plus the mean of the Rx, and vice versa.
    delay_s = _peaks(delays_s, np.concatenate([tx_power, rx_power])) - common / 2
    rows = samples.flattened(echo.length_m, delay_s)
    mean = np.stack([row @ samples.weight for row in rows])
    # Rows and columns are normalised first, or the SVD would follow a single strong channel.
    tx_level, rx_level = by_channel(np.abs(mean), echo.seen)
    right = np.linalg.svd(_ratio(mean * echo.seen, np.outer(tx_level, rx_level)))[2][0]
    started = (np.zeros(n_tx, complex), right * rx_level)
    sides = rank_one(mean * echo.seen, echo.seen.astype(float), *started)
    return np.concatenate(sides), delay_s


def _peaks(delays_s: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Maximum of each row, by the parabola through three samples."""
    at = np.clip(power.argmax(axis=1), 1, delays_s.size - 2)
    low, mid, high = (power[np.arange(len(power)), at + k] for k in (-1, 0, 1))
    bend = low - 2 * mid + high
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(bend < 0, 0.5 * (low - high) / bend, 0.0)
    return np.asarray(delays_s[at] + np.clip(shift, -1.0, 1.0) * (delays_s[1] - delays_s[0]))


def rank_one(
    product: np.ndarray, weight: np.ndarray, tx: np.ndarray, rx: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Minimise sum weight |product / weight - tx rx|^2 by alternating least squares.

    A channel without weight keeps its factor.
    """
    for _ in range(_ALTERNATIONS):
        tx = _ratio(product @ rx.conj(), weight @ np.abs(rx) ** 2, tx)
        rx = _ratio(product.T @ tx.conj(), weight.T @ np.abs(tx) ** 2, rx)
    return tx, rx


def _ratio(
    product: np.ndarray, square: np.ndarray, otherwise: np.ndarray | float = 0.0
) -> np.ndarray:
    return np.where(square > 0, product / np.where(square > 0, square, 1.0), otherwise)


def by_channel(values: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median over the pairs with an echo of each Tx, and of each Rx; 0 without such pairs."""
    masked = np.ma.array(values, mask=~seen)
    tx, rx = (np.ma.filled(np.ma.median(masked, axis=axis), 0.0) for axis in (1, 0))
    return tx, rx


def fit_channels(
    samples: Samples,
    array: AntennaArray,
    target: Target,
    gain: np.ndarray,
    delay_s: np.ndarray,
    tolerance: np.ndarray,
    zero_mean: bool,
    progress: Progress | None = None,
) -> ChannelFit:
    """Refine a start: reduce the capture around it, fit pose and channels, and go on from there.

    `tolerance` are standard deviations of the pose in its units; with `zero_mean` delays scatter
    about zero, else about an unknown common delay.
    """
    nominal = target.parameters
    moved = np.zeros(tolerance.size)

    def placed(away: np.ndarray) -> Target:
        return target.placed(nominal + away * tolerance)

    progress = progress or silent
    for iteration in range(MOST_STEPS):
        progress(iteration, MOST_STEPS)
        echo = placed(moved).echo(array)
        pairs = pairs_of(samples, echo, gain, delay_s)
        # Noise power of one sample of each pair: that of the noisier of its channels.
        floor = NOISE_FLOOR**2 * float(np.median(pairs.model[echo.seen])) ** 2
        noise = np.maximum(np.maximum.outer(*by_channel(pairs.scatter, echo.seen)), floor)
        weight = _weights(samples, pairs, noise, echo.seen)
        best = _channels_near(samples, pairs, weight, delay_s, zero_mean)

        def residuals(away: np.ndarray) -> np.ndarray:
            longer_m = placed(away).echo(array).length_m - echo.length_m  # noqa: B023
            return np.concatenate([best(longer_m)[2], away])  # noqa: B023

        def slopes(away: np.ndarray) -> np.ndarray:
            there, steps = residuals(away), _DIFFERENCE * np.eye(away.size)
            return np.stack([(residuals(away + s) - there) / _DIFFERENCE for s in steps], axis=1)

        ends, before = (-CAPTURE_RANGE, CAPTURE_RANGE), moved
        found = least_squares(residuals, moved, slopes, ends, x_scale=1.0, max_nfev=50)
        moved, covariance = found.x, np.linalg.inv(found.jac.T @ found.jac)
        worst = int(np.abs(moved).argmax())
        if abs(moved[worst]) > 0.99 * CAPTURE_RANGE:  # the solver stays within
            name, unit = target.parameter_names[worst].rsplit("_", 1)
            scale, unit = (1e3, "mm") if unit == "m" else (1.0, "degrees")
            step = scale * tolerance[worst]
            raise CalibrationError(
                f"estimate_channels: the {target.kind} is not in its nominal position, or is "
                f"another: expected {name} {scale * nominal[worst]:.4g} {unit} within "
                f"{CAPTURE_RANGE * step:.3g} {unit}, the fit leads {moved[worst] * step:+.3g} "
                f"{unit} away and on"
            )
        longer_m = placed(moved).echo(array).length_m - echo.length_m
        gains, later, _ = best(longer_m)
        gain = gain * np.exp(np.clip(gains.real, -1.0, 1.0) + 1j * gains.imag)
        delay_s = delay_s + later / samples.spread_rad_per_s
        std = 1.0 / np.sqrt(np.concatenate([weight.sum(axis=1), weight.sum(axis=0)]))
        steps = ((gains, std), (later, std), (moved - before, np.sqrt(np.diag(covariance))))
        if all((np.abs(x) <= np.maximum(STEP_TOLERANCE * s, LEAST_STEP)).all() for x, s in steps):
            break
    else:
        raise CalibrationError(
            f"estimate_channels: expected a fit that settles within {MOST_STEPS} steps, got "
            f"one that still moves: another target than the {target.kind}, or another position"
        )
    progress(MOST_STEPS, MOST_STEPS)
    target = placed(moved)
    echo = target.echo(array)
    covariance = covariance * np.outer(tolerance, tolerance)
    pairs = pairs_of(samples, echo, gain, delay_s)
    return ChannelFit(gain, delay_s, std, target, echo, pairs, noise, covariance)


def pairs_of(samples: Samples, echo: Echo, gain: np.ndarray, delay_s: np.ndarray) -> Pairs:
    """Statistics of each pair, given a trial."""
    late = samples.offset_rad_per_s / samples.spread_rad_per_s
    of_pair = np.outer(*np.split(gain, [len(samples.data)]))
    turn, model = np.exp(-1j * np.angle(of_pair)), np.abs(of_pair)
    found = []
    for i, row in enumerate(samples.flattened(echo.length_m, delay_s)):
        turned = row * turn[i][:, None]
        mean, slope = turned @ samples.weight, turned @ (samples.weight * late)
        left = turned - mean[:, None] - slope[:, None] * late
        beside = turned - model[i][:, None]
        found.append((mean, slope, energy(left), energy(beside)))
    mean, slope, scatter, total = (np.stack(rows) for rows in zip(*found, strict=True))
    # Mean and slope take two degrees of freedom.
    return Pairs(mean, slope, model, scatter / (late.size - 2), total / late.size)


def _weights(samples: Samples, pairs: Pairs, noise: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Information of each pair about its phase, 1/rad^2, with Tukey's weight against outliers."""
    square = np.abs(pairs.mean - pairs.model) ** 2 * samples.frequencies_hz.size / noise
    # The squared magnitude of complex noise has the median ln 2. A larger one is model error: other
    # echoes, or a target whose position is not yet refined.
    excess = max(1.0, float(np.median(square[seen])) / np.log(2.0))
    tukey = np.maximum(np.maximum(1.0 - square / excess / TUKEY_CUTOFF**2, 0.0) ** 2, LEAST_WEIGHT)
    information = 2 * samples.frequencies_hz.size * pairs.model**2 / (noise * excess)
    return np.asarray(information * tukey * seen)


def _channels_near(
    samples: Samples, pairs: Pairs, weight: np.ndarray, delay_s: np.ndarray, zero_mean: bool
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return what finds the channels that fit best for any pose near a trial.

    Its argument is by how many metres the paths are longer than the trial's, shape (n_tx, n_rx); it
    returns what is added to logarithms of gains and phases, real and imaginary, of all Tx and then
    all Rx, and to delays times the spread, rad; and what these leave of phases, delays and the
    delays' prior, over standard deviations. All are sums of a Tx term and an Rx term.
    """
    n_tx, n_rx = weight.shape
    spread, root = samples.spread_rad_per_s, np.sqrt(weight)
    turn_per_m = 2 * np.pi * samples.reference_hz / SPEED_OF_LIGHT_M_PER_S
    late_per_m = spread / SPEED_OF_LIGHT_M_PER_S
    # A prior of the delays, from their own spread (empirical Bayes). For a target whose paths are a
    # sum of two segments only this makes the position observable: a shift is equivalent to delays
    # that follow the antennas' positions.
    delay = spread * delay_s
    centre = np.eye(n_tx + n_rx)
    if not zero_mean:
        for part in (slice(0, n_tx), slice(n_tx, None)):
            centre[part, part] -= 1.0 / len(centre[part])
    variance = float(delay @ centre @ delay) / len(centre)
    prior = centre / np.sqrt(max(variance, (DELAY_FLOOR_S * spread) ** 2))
    of_tx, of_rx = np.diag(weight.sum(axis=1)), np.diag(weight.sum(axis=0))
    normal = np.block([[of_tx, weight], [weight.T, of_rx]])
    null = np.concatenate([np.ones(n_tx), -np.ones(n_rx)])  # changes nothing: regularised
    normal += float(np.mean(np.diag(normal))) * np.outer(null, null) / len(null)
    of_gains, of_delays = cho_factor(normal), cho_factor(normal + prior @ prior)

    def sums(values: np.ndarray) -> np.ndarray:
        return np.concatenate([(weight * values).sum(axis=1), (weight * values).sum(axis=0)])

    def best(longer_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        off = _ratio(pairs.mean, pairs.model) - 1 + 1j * turn_per_m * longer_m
        late = -_ratio(pairs.slope.imag, pairs.model) - late_per_m * longer_m
        gains = cho_solve(of_gains, sums(off))
        delays = cho_solve(of_delays, sums(late) - prior @ (prior @ delay))
        left = root * (off.imag - gains.imag[:n_tx, None] - gains.imag[n_tx:])
        left_late = root * (late - delays[:n_tx, None] - delays[n_tx:])
        of_prior = prior @ (delay + delays)
        return gains, delays, np.concatenate([left.ravel(), left_late.ravel(), of_prior])

    return best

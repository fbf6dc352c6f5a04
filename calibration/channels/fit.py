"""Robust Gauss-Newton fit of channel responses and target pose.

One sample is modelled as

    s[i, k, n] = g_i g_k a_ik exp(j (phi_i + psi_k - nu_n (tau_i + sigma_k) - 2 pi f_n d_ik(p) / c))

with nu_n = 2 pi (f_n - f_ref) and f_ref the mean frequency. Around a trial, three numbers per pair
are sufficient for these parameters: relative amplitude, phase error and delay error. Each is a sum
of a Tx term and an Rx term (a two-way layout), and the pose p enters by the gradient of d_ik(p).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.channels.targets import Echo, Target
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import CalibrationError, ModelError
from clradar.model import AntennaArray
from clradar.model.progress import Progress

TUKEY_CUTOFF = 4.685 / np.sqrt(2.0)
"""Of Tukey's biweight on the magnitude of complex residuals with mean square 1."""

LEAST_WEIGHT = 1e-4
"""Of an outlier, relative to any other pair."""

DELAY_FLOOR_S = 1e-13
"""Smallest prior spread of the delays: 0.03 mm of path."""

NOISE_FLOOR = 1e-5
"""Smallest noise, relative to the echo: far above the rounding of complex64."""

STEP_TOLERANCE = 0.02
"""Converged when no parameter moves by more than this fraction of its standard deviation."""

LEAST_STEP = 1e-5
"""Nor does convergence require smaller steps than this: radians, nepers, pose tolerances."""

MAX_STEP = 0.5
"""Longest step of the pose in units of its tolerance, so that d(p) stays nearly linear."""

CAPTURE_RANGE = 3.0
"""Largest distance of the pose from its nominal one, in units of its tolerance."""

_DIFFERENCE = 1e-4  # step of the numerical gradient, in units of the tolerance
_SCAN_STEPS = 8  # of the search for delays, per resolution cell 1 / bandwidth
_START_ROUNDS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The samples of a capture, with the weights and spectra of an optional delay gate.

    `data`, shape (n_tx, n_rx, n_freq), complex64; `frequencies_hz` and their `weight`, whose sum is
    1, shape (n_freq,); `basis`, shape (n_freq, m), orthonormal spectra in which noise is measured,
    None for all.
    """

    data: np.ndarray
    frequencies_hz: np.ndarray
    weight: np.ndarray
    basis: np.ndarray | None

    @property
    def reference_hz(self) -> float:
        return float(self.weight @ self.frequencies_hz)

    @property
    def offset_rad_per_s(self) -> np.ndarray:
        """2 pi (f - reference), shape (n_freq,): its weighted sum is zero."""
        offset: np.ndarray = 2 * np.pi * (self.frequencies_hz - self.reference_hz)
        return offset

    @property
    def spread_rad_per_s(self) -> float:
        """Root of the weighted mean square of `offset_rad_per_s`."""
        return float(np.sqrt(self.weight @ self.offset_rad_per_s**2))

    @property
    def count(self) -> float:
        """Effective number of samples: the reciprocal of the summed squared weights."""
        return float(1.0 / (self.weight @ self.weight))

    def projected(self, spectra: np.ndarray) -> np.ndarray:
        """Coefficients of spectra, shape (n, n_freq), in `basis`."""
        part: np.ndarray = spectra if self.basis is None else spectra @ self.basis
        return part

    def expanded(self, coefficients: np.ndarray) -> np.ndarray:
        """Spectra, shape (n, n_freq), of coefficients in `basis`."""
        spectra = coefficients if self.basis is None else coefficients @ self.basis.T
        return spectra

    def power(self) -> np.ndarray:
        """Power of one sample of each pair, shape (n_tx, n_rx)."""
        n = self.frequencies_hz.size if self.basis is None else self.basis.shape[1]
        rows = (row.astype(np.complex128) for row in self.data)
        return np.stack([_energy(self.projected(row)) / n for row in rows])

    def flattened(
        self, length_m: np.ndarray, tx_delay_s: np.ndarray, rx_delay_s: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yield per Tx, shape (n_rx, n_freq), the samples without paths and delays."""
        rad_per_m = 2 * np.pi / SPEED_OF_LIGHT_M_PER_S * self.frequencies_hz
        for i, row in enumerate(self.data):
            late = tx_delay_s[i] + rx_delay_s
            phase = length_m[i][:, None] * rad_per_m + late[:, None] * self.offset_rad_per_s
            yield row * np.exp(1j * phase)


def _energy(spectra: np.ndarray) -> np.ndarray:
    energy: np.ndarray = (spectra.real**2 + spectra.imag**2).sum(axis=1)
    return energy


@dataclass(frozen=True, slots=True, eq=False)
class SideResponse:
    """The channels of one side: logarithm of the gain, phase, delay, each of shape (n,)."""

    log_gain: np.ndarray
    phase_rad: np.ndarray
    delay_s: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Sufficient statistics of each pair around a trial, each of shape (n_tx, n_rx).

    `mean` and `slope`, complex128, of the samples after the trial's phases are removed: the mean
    over frequency and the projection on nu / rms(nu); `model`, the trial's amplitude, which equals
    `mean` for a perfect fit; `scatter`, power of one sample beside mean and slope, the noise;
    `total`, power of one sample beside the trial.
    """

    mean: np.ndarray
    slope: np.ndarray
    model: np.ndarray
    scatter: np.ndarray
    total: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Prior knowledge.

    `tolerance`, shape (n_parameters,), standard deviations of the pose parameters in their units;
    `refine`, whether the pose is estimated or fixed; `zero_mean`, whether delays scatter about zero
    or about an unknown common delay.
    """

    tolerance: np.ndarray
    refine: bool
    zero_mean: bool


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFit:
    """The converged fit, with the target in its estimated pose.

    `noise`, shape (n_tx, n_rx), noise power of one sample, from the channels'; `tx_std_rad` and
    `rx_std_rad`, shape (n,), standard deviations of the phases, given the pose; `covariance` of the
    pose parameters, in their units, 0 if the pose is fixed.
    """

    tx: SideResponse
    rx: SideResponse
    target: Target
    echo: Echo
    pairs: Pairs
    noise: np.ndarray
    tx_std_rad: np.ndarray
    rx_std_rad: np.ndarray
    covariance: np.ndarray


def start(samples: Samples, echo: Echo, search_s: float) -> tuple[SideResponse, SideResponse]:
    """Initial estimate of all channels, dead ones too, for a target in its nominal pose.

    The delay of a channel is the maximum of the delay profiles of its pairs, summed in power; gains
    and phases are the best rank-one approximation of the sum over frequency.

    Raises
    ------
    CalibrationError
        The strongest echo is at the end of the delays that are searched.
    """
    n_tx, n_rx, _ = samples.data.shape
    # Both ends, and a step a little finer than 1 / `_SCAN_STEPS` of a cell.
    band_hz = float(np.ptp(samples.frequencies_hz))
    delays_s = np.linspace(
        -search_s, search_s, 2 * int(np.ceil(_SCAN_STEPS * search_s * band_hz)) + 1
    )
    steer = samples.weight[:, None] * np.exp(1j * samples.offset_rad_per_s[:, None] * delays_s)
    tx_power, rx_power = np.zeros((n_tx, delays_s.size)), np.zeros((n_rx, delays_s.size))
    rows = samples.flattened(echo.length_m, np.zeros(n_tx), np.zeros(n_rx))
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
    tx_delay = _peaks(delays_s, tx_power) - common / 2
    rx_delay = _peaks(delays_s, rx_power) - common / 2
    rows = samples.flattened(echo.length_m, tx_delay, rx_delay)
    mean = np.stack([row @ samples.weight for row in rows])
    tx, rx = _rank_one(mean, np.where(echo.seen, echo.amplitude, 0.0))
    with np.errstate(divide="ignore"):
        return (
            SideResponse(np.log(np.abs(tx)), np.angle(tx), tx_delay),
            SideResponse(np.log(np.abs(rx)), np.angle(rx), rx_delay),
        )


def _peaks(delays_s: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Maximum of each row, by the parabola through three samples."""
    at = np.clip(power.argmax(axis=1), 1, delays_s.size - 2)
    low, mid, high = (power[np.arange(len(power)), at + k] for k in (-1, 0, 1))
    bend = low - 2 * mid + high
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(bend < 0, 0.5 * (low - high) / bend, 0.0)
    peak: np.ndarray = delays_s[at] + np.clip(shift, -1.0, 1.0) * (delays_s[1] - delays_s[0])
    return peak


def _rank_one(mean: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors g and h whose weight g h^T is nearest to `mean`, by alternating least squares."""
    # Rows and columns are normalised first, or the SVD would follow a single strong channel.
    level = by_channel(np.abs(mean), weight > 0)
    rows, columns = (np.where(x > 0, x, np.inf) for x in level)
    left, _, right = np.linalg.svd(mean * (weight > 0) / rows[:, None] / columns[None, :])
    g, h = left[:, 0] * level[0], right[0] * level[1]
    for _ in range(_START_ROUNDS):
        g = _ratio((mean * weight) @ h.conj(), weight**2 @ np.abs(h) ** 2)
        h = _ratio((mean * weight).T @ g.conj(), (weight**2).T @ np.abs(g) ** 2)
    return g, h


def _ratio(product: np.ndarray, square: np.ndarray) -> np.ndarray:
    return np.where(square > 0, product / np.where(square > 0, square, 1.0), 0.0)


def by_channel(values: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median over the pairs with an echo of each Tx, and of each Rx; 0 without such pairs."""
    masked = np.ma.array(values, mask=~seen)
    tx, rx = (np.ma.filled(np.ma.median(masked, axis=axis), 0.0) for axis in (1, 0))
    return tx, rx


def fit_channels(
    samples: Samples,
    array: AntennaArray,
    target: Target,
    tx: SideResponse,
    rx: SideResponse,
    prior: Prior,
    max_iterations: int,
    progress: Progress | None = None,
) -> ChannelFit:
    """Refine a start by weighted, robust Gauss-Newton steps on channels and pose together.

    Raises
    ------
    CalibrationError
        The target leaves the capture range, or the steps do not converge.
    """
    nominal = target.parameters
    tolerance = prior.tolerance if prior.refine else prior.tolerance[:0]
    for iteration in range(max_iterations):
        if progress is not None:
            progress(iteration, max_iterations)
        echo = target.echo(array)
        pairs = pairs_of(samples, echo, tx, rx)
        _check_explained(pairs, echo.seen, target)
        noise = _noise(pairs, echo.seen)
        weight = _weights(samples, pairs, noise, echo.seen)
        gradient = _gradient(target, array, tolerance)
        moved = (target.parameters - nominal)[: tolerance.size] / tolerance
        try:
            step = _solved(samples, pairs, weight, gradient, moved, (tx, rx), prior.zero_mean)
            gain_step = _gain_step(pairs, weight)
        except np.linalg.LinAlgError as error:
            raise CalibrationError(
                f"estimate_channels: the {target.kind} does not explain the capture: where the fit "
                "leads, some channels have no echo of it"
            ) from error
        # All parameters are scaled together: phases compensate the motion of the target.
        longest = float(np.abs(step.pose).max(initial=0.0))
        step = step.scaled(min(1.0, MAX_STEP / longest) if longest > 0 else 1.0)
        n_tx, spread = tx.phase_rad.size, samples.spread_rad_per_s
        tx = _stepped(tx, step, gain_step, slice(0, n_tx), spread)
        rx = _stepped(rx, step, gain_step, slice(n_tx, None), spread)
        if tolerance.size:
            target = _placed(target, target.parameters + step.pose * tolerance)
            _check_range(target, nominal, tolerance)
        if _small(step, gain_step, weight):
            break
    else:
        raise CalibrationError(
            f"estimate_channels: expected a fit that settles within {max_iterations} steps, got "
            f"one that still moves: another target than the {target.kind}, or another position"
        )
    if progress is not None:
        progress(max_iterations, max_iterations)
    echo = target.echo(array)
    covariance = np.zeros((nominal.size, nominal.size))
    covariance[: tolerance.size, : tolerance.size] = step.covariance * np.outer(
        tolerance, tolerance
    )
    std = 1.0 / np.sqrt(np.diag(_two_way(weight)))
    pairs = pairs_of(samples, echo, tx, rx)
    return ChannelFit(tx, rx, target, echo, pairs, noise, std[:n_tx], std[n_tx:], covariance)


def pairs_of(samples: Samples, echo: Echo, tx: SideResponse, rx: SideResponse) -> Pairs:
    """Sufficient statistics of each pair, given a trial."""
    slope = samples.offset_rad_per_s / samples.spread_rad_per_s
    shapes = np.stack([np.ones_like(slope), slope])
    inside = samples.projected(shapes)
    # Mean and slope of each pair, and the inner products of both with the gated samples.
    readers = np.concatenate([shapes * samples.weight, samples.expanded(inside)]).T
    readings = np.empty((*echo.length_m.shape, 4), dtype=np.complex128)
    energy = np.empty(echo.length_m.shape)
    for i, row in enumerate(samples.flattened(echo.length_m, tx.delay_s, rx.delay_s)):
        readings[i] = row @ readers
        energy[i] = _energy(samples.projected(row))
    model = np.exp(tx.log_gain[:, None] + rx.log_gain[None, :]) * echo.amplitude
    phasor = np.exp(1j * (tx.phase_rad[:, None] + rx.phase_rad[None, :]))
    readings *= phasor.conj()[:, :, None]
    fitted, read = readings[:, :, :2], readings[:, :, 2:]

    def residual(amplitudes: np.ndarray, k: int) -> np.ndarray:
        """Energy in the basis after the first k shapes of these amplitudes are subtracted."""
        taken = np.einsum(
            "abi,ij,abj->ab", amplitudes, (inside @ inside.T)[:k, :k], amplitudes.conj()
        )
        crossed = (amplitudes.conj() * read[:, :, :k]).sum(axis=2)
        return np.maximum(energy - 2 * crossed.real + taken.real, 0.0)

    # Energy of unit white noise in the basis, as it is and without mean and slope.
    n = slope.size
    bare = float(np.square(samples.projected(np.eye(n))).sum())
    fitting = (shapes * samples.weight).T @ shapes
    flat = float(np.square(samples.projected(np.eye(n) - fitting)).sum())
    return Pairs(
        mean=fitted[:, :, 0],
        slope=fitted[:, :, 1],
        model=model,
        scatter=residual(fitted, 2) / flat,
        total=residual(model[:, :, None], 1) / bare,
    )


def _noise(pairs: Pairs, seen: np.ndarray) -> np.ndarray:
    """Noise power of one sample of each pair: that of the noisier of its channels."""
    by_tx, by_rx = by_channel(pairs.scatter, seen)
    floor = NOISE_FLOOR**2 * float(np.median(pairs.model[seen])) ** 2
    return np.maximum(np.maximum(by_tx[:, None], by_rx[None, :]), floor)


def _weights(samples: Samples, pairs: Pairs, noise: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Information of each pair about its phase, 1/rad^2, with Tukey's weight against outliers."""
    square = np.abs(pairs.mean - pairs.model) ** 2 * samples.count / noise
    # The squared magnitude of complex noise has the median ln 2. A larger one is model error: other
    # echoes, or a target whose position is not yet refined.
    excess = max(1.0, float(np.median(square[seen])) / np.log(2.0))
    # Never 0: a channel all of whose pairs are outliers still needs a solution.
    tukey = np.maximum(np.maximum(1.0 - square / excess / TUKEY_CUTOFF**2, 0.0) ** 2, LEAST_WEIGHT)
    information = 2 * samples.count * pairs.model**2 / (noise * excess)
    weight: np.ndarray = information * tukey * seen
    return weight


def _gradient(target: Target, array: AntennaArray, tolerance: np.ndarray) -> np.ndarray:
    """Derivative of the paths by each parameter, shape (n, n_tx, n_rx), metres per tolerance."""
    gradient = np.zeros((tolerance.size, array.n_tx, array.n_rx))
    for k, step in enumerate(_DIFFERENCE * np.diag(tolerance)):
        ends = [_placed(target, target.parameters + sign * step) for sign in (1, -1)]
        high, low = (end.echo(array).length_m for end in ends)
        gradient[k] = (high - low) / (2 * _DIFFERENCE)
    return gradient


def _two_way(weight: np.ndarray) -> np.ndarray:
    """Normal matrix of a sum of a Tx term and an Rx term, shape (n_tx + n_rx,) * 2."""
    return np.block(
        [
            [np.diag(weight.sum(axis=1)), weight],
            [weight.T, np.diag(weight.sum(axis=0))],
        ]
    )


def _sums(values: np.ndarray) -> np.ndarray:
    """Sums by Tx and by Rx, shape (n_tx + n_rx, ...)."""
    return np.concatenate([values.sum(axis=1), values.sum(axis=0)])


def _constrained_two_way(weight: np.ndarray) -> np.ndarray:
    """`_two_way`, regularised in its null space: all Tx up, all Rx down."""
    matrix = _two_way(weight)
    n_tx, n_rx = weight.shape
    null = np.concatenate([np.ones(n_tx), -np.ones(n_rx)]) / np.sqrt(n_tx + n_rx)
    return matrix + float(np.mean(np.diag(matrix))) * np.outer(null, null)


def _gain_step(pairs: Pairs, weight: np.ndarray) -> np.ndarray:
    """Change of all logarithms of gains."""
    excess = pairs.mean.real / pairs.model - 1.0
    return np.clip(np.linalg.solve(_constrained_two_way(weight), _sums(weight * excess)), -1.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """Changes of phases (rad), of delays (times the spread, rad) and of the pose (tolerances)."""

    phase: np.ndarray
    delay: np.ndarray
    pose: np.ndarray
    covariance: np.ndarray

    def scaled(self, factor: float) -> _Step:
        return _Step(factor * self.phase, factor * self.delay, factor * self.pose, self.covariance)


def _solved(
    samples: Samples,
    pairs: Pairs,
    weight: np.ndarray,
    gradient: np.ndarray,
    moved: np.ndarray,
    sides: tuple[SideResponse, SideResponse],
    zero_mean: bool,
) -> _Step:
    """Gauss-Newton step of phases, delays and pose, and the covariance of the pose.

    The effect of a motion on the paths is split into the best sum of a Tx term and an Rx term,
    which the channels compensate, and the rest, which only a motion explains. In terms of channels
    that include the first, the data do not couple channels and pose.
    """
    n_tx, n = weight.shape[0], sum(weight.shape)
    m = len(gradient)
    two_way = _constrained_two_way(weight)
    split = (
        np.linalg.solve(two_way, np.stack([_sums(weight * g) for g in gradient], axis=1))
        if m
        else np.zeros((n, 0))
    )
    rest = gradient - split[:n_tx].T[:, :, None] - split[n_tx:].T[:, None, :]
    # A longer path decreases the phase and increases the delay.
    per_phase = -2 * np.pi * samples.reference_hz / SPEED_OF_LIGHT_M_PER_S
    per_delay = samples.spread_rad_per_s / SPEED_OF_LIGHT_M_PER_S
    ahead, late = pairs.mean.imag / pairs.model, -pairs.slope.imag / pairs.model
    phase = np.linalg.solve(two_way, _sums(weight * ahead))

    delay_now = samples.spread_rad_per_s * np.concatenate([side.delay_s for side in sides])
    smooth = _delay_precision(delay_now, n_tx, samples.spread_rad_per_s, zero_mean)
    follows = per_delay * split
    flat = rest.reshape(m, weight.size)
    information = (per_phase**2 + per_delay**2) * (flat * weight.ravel()) @ flat.T
    normal = np.block(
        [
            [two_way + smooth, -smooth @ follows],
            [-follows.T @ smooth, information + follows.T @ smooth @ follows + np.eye(m)],
        ]
    )
    score = flat @ (weight * (per_phase * ahead + per_delay * late)).ravel()
    right = np.concatenate(
        [
            _sums(weight * late) - smooth @ delay_now,
            score + follows.T @ smooth @ delay_now - moved,
        ]
    )
    inverse = np.linalg.inv(normal)
    solution = inverse @ right
    pose = solution[n:]
    return _Step(
        phase - per_phase * split @ pose, solution[:n] - follows @ pose, pose, inverse[n:, n:]
    )


def _delay_precision(delay: np.ndarray, n_tx: int, spread: float, zero_mean: bool) -> np.ndarray:
    """Prior inverse covariance of the delays, from their own spread (empirical Bayes).

    For a target whose paths are a sum of two segments only this prior makes the position
    observable: a shift is equivalent to delays that follow the antennas' positions.
    """
    n = delay.size
    centre = np.eye(n)
    if not zero_mean:
        for part in (slice(0, n_tx), slice(n_tx, n)):
            centre[part, part] -= 1.0 / (part.stop - part.start)
    variance = max(float(delay @ centre @ delay) / n, (DELAY_FLOOR_S * spread) ** 2)
    precision: np.ndarray = centre / variance
    return precision


def _stepped(
    old: SideResponse, step: _Step, gain_step: np.ndarray, part: slice, spread: float
) -> SideResponse:
    return SideResponse(
        old.log_gain + gain_step[part],
        old.phase_rad + step.phase[part],
        old.delay_s + step.delay[part] / spread,
    )


def _small(step: _Step, gain_step: np.ndarray, weight: np.ndarray) -> bool:
    """Whether a step is negligible compared with the standard deviations of its parameters."""
    std = 1.0 / np.sqrt(np.diag(_two_way(weight)))
    pose_std = np.sqrt(np.diag(step.covariance))
    parts = ((gain_step, std), (step.phase, std), (step.delay, std), (step.pose, pose_std))
    return all(
        bool((np.abs(x) <= np.maximum(STEP_TOLERANCE * s, LEAST_STEP)).all()) for x, s in parts
    )


def _placed(target: Target, parameters: np.ndarray) -> Target:
    try:
        return target.placed(parameters)
    except ModelError as error:
        raise CalibrationError(
            f"estimate_channels: the {target.kind} does not explain the capture: its fit leads to "
            f"an impossible pose ({error})"
        ) from error


def _check_explained(pairs: Pairs, seen: np.ndarray, target: Target) -> None:
    left = np.square(np.abs(pairs.mean - pairs.model)[seen]).sum()
    if not left <= np.square(np.abs(pairs.mean[seen])).sum():
        raise CalibrationError(
            f"estimate_channels: the {target.kind} does not explain the capture: subtracting its "
            "echoes leaves more than there was. Another target, or another position"
        )


def _check_range(target: Target, nominal: np.ndarray, tolerance: np.ndarray) -> None:
    off = (target.parameters - nominal) / tolerance
    worst = int(np.abs(off).argmax())
    if abs(off[worst]) > CAPTURE_RANGE:
        name, unit = target.parameter_names[worst].rsplit("_", 1)
        scale, unit = (1e3, "mm") if unit == "m" else (1.0, "degrees")
        raise CalibrationError(
            f"estimate_channels: the {target.kind} is not in its nominal position, or is another: "
            f"expected {name} {scale * nominal[worst]:.4g} {unit} within "
            f"{CAPTURE_RANGE * scale * tolerance[worst]:.3g} {unit}, the fit leads "
            f"{scale * off[worst] * tolerance[worst]:+.3g} {unit} away and on"
        )

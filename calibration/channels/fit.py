"""The least-squares fit behind `estimate_channels`: channels and the place of the target.

One sample is modelled as

    s[i, k, n] = g_i g_k a_ik exp(j (phi_i + psi_k - nu_n (tau_i + sigma_k) - 2 pi f_n d_ik(p) / c))

with nu_n = 2 pi (f_n - f_ref) and f_ref the mean frequency. Around a trial, each pair has three
numbers that tell all there is to tell about these parameters: how much larger, how far ahead in
phase and how much later it is than the trial. Each is a sum of a part of the Tx and a part of the
Rx (a two-way layout), and the motion of the target enters through the gradient of d_ik(p).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.channels.targets import Echo, Target
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import CalibrationError, ModelError
from clradar.model import AntennaArray

TUKEY_CUTOFF = 4.685 / np.sqrt(2.0)
"""Of Tukey's biweight on the magnitude of complex residuals with mean square 1."""

LEAST_WEIGHT = 1e-4
"""Of an outlier, relative to any other pair."""

DELAY_FLOOR_S = 1e-13
"""Least spread of delays that is assumed: 0.03 mm of path."""

NOISE_FLOOR = 1e-5
"""Least noise that is assumed, relative to the echo: far above the rounding of complex64."""

STEP_TOLERANCE = 0.02
"""Converged when nothing moves by more than this share of its standard deviation."""

LEAST_STEP = 1e-5
"""Nor is anything asked to move less than this: radians, nepers, tolerances of the target."""

MAX_STEP = 0.5
"""Longest step of the target in units of its tolerance, so that it stays where d(p) is linear."""

CAPTURE_RANGE = 3.0
"""In units of its tolerance, how far from where it was said to be a target may be found."""

_DIFFERENCE = 1e-4  # step of the numerical gradient, in units of the tolerance
_SCAN_STEPS = 8  # of the search for delays, per resolution cell 1 / bandwidth
_START_ROUNDS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """What the fit sees of a capture.

    Attributes
    ----------
    data : ndarray, shape (n_tx, n_rx, n_freq), complex64
    frequencies_hz : ndarray, shape (n_freq,), float64
    weight : ndarray, shape (n_freq,), float64
        Of each frequency; their sum is 1.
    basis : ndarray, shape (n_freq, m), float64, or None
        Orthonormal spectra in which noise is looked for; None for all.
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
        """How many samples of equal weight would average noise as well."""
        return float(1.0 / (self.weight @ self.weight))

    def within(self, spectra: np.ndarray) -> np.ndarray:
        """Return the part of spectra, shape (n, n_freq), that noise is looked for in."""
        part: np.ndarray = spectra if self.basis is None else spectra @ self.basis
        return part

    def without(self, part: np.ndarray) -> np.ndarray:
        """Return as spectra what `within` returned, shape (n, n_freq)."""
        spectra: np.ndarray = part if self.basis is None else part @ self.basis.T
        return spectra

    def power(self) -> np.ndarray:
        """Return the power of one sample of each pair, shape (n_tx, n_rx)."""
        n = self.frequencies_hz.size if self.basis is None else self.basis.shape[1]
        rows = (row.astype(np.complex128) for row in self.data)
        return np.stack([_energy(self.within(row)) / n for row in rows])

    def flattened(
        self, length_m: np.ndarray, tx_delay_s: np.ndarray, rx_delay_s: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yield per Tx, shape (n_rx, n_freq), what is left when paths and delays are taken off."""
        turns = 2 * np.pi / SPEED_OF_LIGHT_M_PER_S * self.frequencies_hz
        for i, row in enumerate(self.data):
            late = tx_delay_s[i] + rx_delay_s
            phase = length_m[i][:, None] * turns + late[:, None] * self.offset_rad_per_s
            yield row * np.exp(1j * phase)


def _energy(spectra: np.ndarray) -> np.ndarray:
    energy: np.ndarray = (spectra.real**2 + spectra.imag**2).sum(axis=1)
    return energy


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """The channels of one side: logarithm of the gain, phase, delay, each of shape (n,)."""

    log_gain: np.ndarray
    phase_rad: np.ndarray
    delay_s: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """All that the data says about each pair around a trial, each of shape (n_tx, n_rx).

    Attributes
    ----------
    mean, slope : complex128
        Of the samples with the trial's phases taken off: the mean over frequency, and the
        projection on nu / rms(nu).
    model : float64
        The trial's amplitude; `mean` would be equal to it.
    scatter : float64
        Noise power of one sample: what neither mean nor slope explain.
    total : float64
        Power of one sample that the trial does not explain.
    """

    mean: np.ndarray
    slope: np.ndarray
    model: np.ndarray
    scatter: np.ndarray
    total: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known besides the samples.

    Attributes
    ----------
    tolerance : ndarray, shape (n_parameters,), float64
        Standard deviation of the target's parameters, in their units.
    refine : bool
        Whether the target may move; it is held where it is if not.
    zero_mean : bool
        Whether delays scatter about zero, or about a common delay that is unknown.
    """

    tolerance: np.ndarray
    refine: bool
    zero_mean: bool


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where the fit ended.

    Attributes
    ----------
    tx, rx : Side
    target : Target
        Where it was found.
    echo : Echo
        Of the target there.
    pairs : Pairs
    noise : ndarray, shape (n_tx, n_rx), float64
        Noise power of one sample, from the channels'.
    tx_std_rad, rx_std_rad : ndarray, shape (n,), float64
        Standard deviation of each phase if the target is where it was found.
    covariance : ndarray, shape (n_parameters, n_parameters), float64
        Of the target's parameters, in their units; 0 if it was held.
    """

    tx: Side
    rx: Side
    target: Target
    echo: Echo
    pairs: Pairs
    noise: np.ndarray
    tx_std_rad: np.ndarray
    rx_std_rad: np.ndarray
    covariance: np.ndarray


def start(samples: Samples, echo: Echo, search_s: float) -> tuple[Side, Side]:
    """Return a first estimate of all channels, dead ones too, for a target that is held.

    The delay of a channel is where the profiles of its pairs, summed in power, have their maximum;
    gains and phases are the best rank-one approximation of the sum over frequency.

    Raises
    ------
    CalibrationError
        The strongest echo is at the end of the delays that are searched.
    """
    n_tx, n_rx, _ = samples.data.shape
    # Both ends, and the step a little finer than asked for.
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
    common = _peak(delays_s, tx_power.sum(axis=0)[None, :])[0]
    if abs(common) > search_s - 0.5 / band_hz / _SCAN_STEPS:
        reach_mm = 500.0 * search_s * SPEED_OF_LIGHT_M_PER_S
        raise CalibrationError(
            "estimate_channels: expected an echo of the target within "
            f"{reach_mm:.0f} mm of its range, found a stronger one at the end of that window"
        )
    # A Tx shows its delay and the mean of the Rx, and the other way round.
    tx_delay = _peak(delays_s, tx_power) - common / 2
    rx_delay = _peak(delays_s, rx_power) - common / 2
    rows = samples.flattened(echo.length_m, tx_delay, rx_delay)
    mean = np.stack([row @ samples.weight for row in rows])
    tx, rx = _rank_one(mean, np.where(echo.seen, echo.amplitude, 0.0))
    return _side(tx, tx_delay), _side(rx, rx_delay)


def _peak(delays_s: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Return where each row has its maximum, by the parabola through three samples."""
    at = np.clip(power.argmax(axis=1), 1, delays_s.size - 2)
    low, mid, high = (power[np.arange(len(power)), at + k] for k in (-1, 0, 1))
    bend = low - 2 * mid + high
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(bend < 0, 0.5 * (low - high) / bend, 0.0)
    peak: np.ndarray = delays_s[at] + np.clip(shift, -1.0, 1.0) * (delays_s[1] - delays_s[0])
    return peak


def _side(gain: np.ndarray, delay_s: np.ndarray) -> Side:
    with np.errstate(divide="ignore"):
        return Side(np.log(np.abs(gain)), np.angle(gain), delay_s)


def _rank_one(mean: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return g and h for which weight g h^T fits `mean` in the least squares, by alternation."""
    # Rows and columns are brought to one level first: one loud channel must not be the answer.
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
    """Return the median of the pairs of each Tx, and of each Rx."""
    return _median_of_seen(values, seen, 1), _median_of_seen(values, seen, 0)


def _median_of_seen(values: np.ndarray, seen: np.ndarray, axis: int) -> np.ndarray:
    """Return the median along an axis of what is seen; 0 where nothing is."""
    found = np.ma.median(np.ma.array(values, mask=~seen), axis=axis)
    median: np.ndarray = np.ma.filled(found, 0.0)
    return median


def fit(
    samples: Samples,
    array: AntennaArray,
    target: Target,
    tx: Side,
    rx: Side,
    prior: Prior,
    max_iterations: int,
) -> Fit:
    """Refine a start by weighted, robust Gauss-Newton steps on channels and target together.

    Raises
    ------
    CalibrationError
        The target moves out of the capture range, or the steps do not end.
    """
    said = target.parameters
    tolerance = prior.tolerance if prior.refine else prior.tolerance[:0]
    for _ in range(max_iterations):
        echo = target.echo(array)
        pairs = pairs_of(samples, echo, tx, rx)
        _check_sense(pairs, echo.seen, target)
        noise = _noise(pairs, echo.seen)
        weight = _weights(samples, pairs, noise, echo.seen)
        gradient = _gradient(target, array, tolerance)
        moved = (target.parameters - said)[: tolerance.size] / tolerance
        try:
            step = _solved(samples, pairs, weight, gradient, moved, (tx, rx), prior.zero_mean)
            gain_step = _gain_step(pairs, weight)
        except np.linalg.LinAlgError as error:
            raise CalibrationError(
                f"estimate_channels: the {target.kind} does not explain the capture: where the fit "
                "leads, some channels have no echo of it"
            ) from error
        # A part of a step is taken in all that moves: phases make up for the target's motion.
        longest = float(np.abs(step.place).max(initial=0.0))
        step = step.times(min(1.0, MAX_STEP / longest) if longest > 0 else 1.0)
        tx, rx = _stepped(tx, rx, step, gain_step, samples.spread_rad_per_s)
        if tolerance.size:
            target = _placed(target, target.parameters + step.place * tolerance)
            _check_range(target, said, tolerance)
        if _small(step, gain_step, weight):
            break
    else:
        raise CalibrationError(
            f"estimate_channels: expected a fit that settles within {max_iterations} steps, got "
            f"one that still moves: another target than the {target.kind}, or another place"
        )
    echo = target.echo(array)
    pairs = pairs_of(samples, echo, tx, rx)
    n_tx = tx.phase_rad.size
    covariance = np.zeros((said.size, said.size))
    covariance[: tolerance.size, : tolerance.size] = step.covariance * np.outer(
        tolerance, tolerance
    )
    spread = 1.0 / np.sqrt(np.diag(_two_way(weight)))
    return Fit(tx, rx, target, echo, pairs, noise, spread[:n_tx], spread[n_tx:], covariance)


def pairs_of(samples: Samples, echo: Echo, tx: Side, rx: Side) -> Pairs:
    """Return what the samples say about each pair, given a trial."""
    slope = samples.offset_rad_per_s / samples.spread_rad_per_s
    shapes = np.stack([np.ones_like(slope), slope])
    inside = samples.within(shapes)
    # Each pair's mean, slope, and the two again as far as they are within what noise is read from.
    readers = np.concatenate([shapes * samples.weight, samples.without(inside)]).T
    readings = np.empty((*echo.length_m.shape, 4), dtype=np.complex128)
    energy = np.empty(echo.length_m.shape)
    for i, row in enumerate(samples.flattened(echo.length_m, tx.delay_s, rx.delay_s)):
        readings[i] = row @ readers
        energy[i] = _energy(samples.within(row))
    model = np.exp(tx.log_gain[:, None] + rx.log_gain[None, :]) * echo.amplitude
    turn = np.exp(1j * (tx.phase_rad[:, None] + rx.phase_rad[None, :]))
    readings *= turn.conj()[:, :, None]
    fitted, read = readings[:, :, :2], readings[:, :, 2:]

    def left(amplitudes: np.ndarray, k: int) -> np.ndarray:
        """Return the energy within once so much of the first k shapes is taken off."""
        taken = np.einsum(
            "abi,ij,abj->ab", amplitudes, (inside @ inside.T)[:k, :k], amplitudes.conj()
        )
        crossed = (amplitudes.conj() * read[:, :, :k]).sum(axis=2)
        return np.maximum(energy - 2 * crossed.real + taken.real, 0.0)

    # What noise of power 1 in every sample leaves within, as it is and without mean and slope.
    n = slope.size
    bare = float(np.square(samples.within(np.eye(n))).sum())
    fitting = (shapes * samples.weight).T @ shapes
    flat = float(np.square(samples.within(np.eye(n) - fitting)).sum())
    return Pairs(
        mean=fitted[:, :, 0],
        slope=fitted[:, :, 1],
        model=model,
        scatter=left(fitted, 2) / flat,
        total=left(model[:, :, None], 1) / bare,
    )


def _noise(pairs: Pairs, seen: np.ndarray) -> np.ndarray:
    """Return the noise power of one sample of each pair: that of the noisier of its channels."""
    by_tx, by_rx = by_channel(pairs.scatter, seen)
    floor = NOISE_FLOOR**2 * float(np.median(pairs.model[seen])) ** 2
    return np.maximum(np.maximum(by_tx[:, None], by_rx[None, :]), floor)


def _weights(samples: Samples, pairs: Pairs, noise: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the information of each pair about its phase, 1/rad^2, less where it is an outlier."""
    square = np.abs(pairs.mean - pairs.model) ** 2 * samples.count / noise
    # The square of complex noise has the median ln 2. More than that is what the model does not
    # have: other echoes, or a target that is not yet in its place.
    excess = max(1.0, float(np.median(square[seen])) / np.log(2.0))
    # Never quite nothing: a channel all of whose pairs are outliers still has to be somewhere.
    tukey = np.maximum(np.maximum(1.0 - square / excess / TUKEY_CUTOFF**2, 0.0) ** 2, LEAST_WEIGHT)
    information = 2 * samples.count * pairs.model**2 / (noise * excess)
    weight: np.ndarray = information * tukey * seen
    return weight


def _gradient(target: Target, array: AntennaArray, tolerance: np.ndarray) -> np.ndarray:
    """Return how the paths grow with each parameter, shape (n, n_tx, n_rx), m per tolerance."""
    rows = []
    for k in range(tolerance.size):
        step = np.zeros(tolerance.size)
        step[k] = _DIFFERENCE * tolerance[k]
        ends = [_placed(target, target.parameters + sign * step) for sign in (1, -1)]
        high, low = (end.echo(array).length_m for end in ends)
        rows.append((high - low) / (2 * _DIFFERENCE))
    n_tx, n_rx = len(array.tx_m), len(array.rx_m)
    return np.stack(rows) if rows else np.zeros((0, n_tx, n_rx))


def _two_way(weight: np.ndarray) -> np.ndarray:
    """Return the normal matrix of a sum of a Tx part and an Rx part, shape (n_tx + n_rx,) * 2."""
    return np.block(
        [
            [np.diag(weight.sum(axis=1)), weight],
            [weight.T, np.diag(weight.sum(axis=0))],
        ]
    )


def _sums(values: np.ndarray) -> np.ndarray:
    """Return the sums by Tx and by Rx, shape (n_tx + n_rx, ...)."""
    return np.concatenate([values.sum(axis=1), values.sum(axis=0)])


def _opposite(n_tx: int, n_rx: int) -> np.ndarray:
    """Return the direction that no pair sees: all Tx up, all Rx down."""
    return np.concatenate([np.ones(n_tx), -np.ones(n_rx)]) / np.sqrt(n_tx + n_rx)


def _held_two_way(weight: np.ndarray) -> np.ndarray:
    """Return the same without motion in the direction that it does not see."""
    matrix = _two_way(weight)
    unseen = _opposite(*weight.shape)
    return matrix + float(np.mean(np.diag(matrix))) * np.outer(unseen, unseen)


def _gain_step(pairs: Pairs, weight: np.ndarray) -> np.ndarray:
    """Return the change of all logarithms of gains."""
    louder = pairs.mean.real / pairs.model - 1.0
    return np.clip(np.linalg.solve(_held_two_way(weight), _sums(weight * louder)), -1.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """Changes of phases (rad), of delays (times the spread, rad) and of the place (tolerances)."""

    phase: np.ndarray
    delay: np.ndarray
    place: np.ndarray
    covariance: np.ndarray

    def times(self, factor: float) -> _Step:
        return _Step(factor * self.phase, factor * self.delay, factor * self.place, self.covariance)


def _solved(
    samples: Samples,
    pairs: Pairs,
    weight: np.ndarray,
    gradient: np.ndarray,
    moved: np.ndarray,
    sides: tuple[Side, Side],
    zero_mean: bool,
) -> _Step:
    """Return the step that minimises the weighted squares, and the covariance of the place.

    What a motion of the target does to the paths is split into the best sum of a Tx part and an
    Rx part, which the channels make up for, and the rest, which only a motion can do. In terms of
    channels that include the first, the data does not couple channels and place at all.
    """
    n_tx, n = weight.shape[0], sum(weight.shape)
    m = len(gradient)
    two_way = _held_two_way(weight)
    split = (
        np.linalg.solve(two_way, np.stack([_sums(weight * g) for g in gradient], axis=1))
        if m
        else np.zeros((n, 0))
    )
    rest = gradient - split[:n_tx].T[:, :, None] - split[n_tx:].T[:, None, :]
    # A longer path sets the phase back and adds to the delay.
    per_phase = -2 * np.pi * samples.reference_hz / SPEED_OF_LIGHT_M_PER_S
    per_delay = samples.spread_rad_per_s / SPEED_OF_LIGHT_M_PER_S
    ahead, late = pairs.mean.imag / pairs.model, -pairs.slope.imag / pairs.model
    phase = np.linalg.solve(two_way, _sums(weight * ahead))

    delay_now = samples.spread_rad_per_s * np.concatenate([side.delay_s for side in sides])
    smooth = _smoothness(delay_now, n_tx, samples.spread_rad_per_s, zero_mean)
    follows = per_delay * split
    flat = rest.reshape(m, weight.size)
    told = (per_phase**2 + per_delay**2) * (flat * weight.ravel()) @ flat.T
    normal = np.block(
        [
            [two_way + smooth, -smooth @ follows],
            [-follows.T @ smooth, told + follows.T @ smooth @ follows + np.eye(m)],
        ]
    )
    seen = flat @ (weight * (per_phase * ahead + per_delay * late)).ravel()
    right = np.concatenate(
        [
            _sums(weight * late) - smooth @ delay_now,
            seen + follows.T @ smooth @ delay_now - moved,
        ]
    )
    inverse = np.linalg.inv(normal)
    solution = inverse @ right
    place = solution[n:]
    return _Step(
        phase - per_phase * split @ place, solution[:n] - follows @ place, place, inverse[n:, n:]
    )


def _smoothness(delay: np.ndarray, n_tx: int, spread: float, zero_mean: bool) -> np.ndarray:
    """Return the inverse covariance of the delays before any measurement, from their own spread.

    Delays that scatter at random are the only thing that tells where a target is whose paths are a
    sum of two legs: a shift of it would look like delays that follow the antennas' positions.
    """
    n = delay.size
    centre = np.eye(n)
    if not zero_mean:
        for part in (slice(0, n_tx), slice(n_tx, n)):
            centre[part, part] -= 1.0 / (part.stop - part.start)
    variance = max(float(delay @ centre @ delay) / n, (DELAY_FLOOR_S * spread) ** 2)
    smooth: np.ndarray = centre / variance
    return smooth


def _stepped(
    tx: Side, rx: Side, step: _Step, gain_step: np.ndarray, spread: float
) -> tuple[Side, Side]:
    def side(old: Side, part: slice) -> Side:
        return Side(
            old.log_gain + gain_step[part],
            old.phase_rad + step.phase[part],
            old.delay_s + step.delay[part] / spread,
        )

    n_tx = tx.phase_rad.size
    return side(tx, slice(0, n_tx)), side(rx, slice(n_tx, None))


def _small(step: _Step, gain_step: np.ndarray, weight: np.ndarray) -> bool:
    """Whether a step is nothing compared with how well its parameters are known."""
    std = 1.0 / np.sqrt(np.diag(_two_way(weight)))
    place_std = np.sqrt(np.diag(step.covariance))
    parts = ((gain_step, std), (step.phase, std), (step.delay, std), (step.place, place_std))
    return all(
        bool((np.abs(x) <= np.maximum(STEP_TOLERANCE * s, LEAST_STEP)).all()) for x, s in parts
    )


def _placed(target: Target, parameters: np.ndarray) -> Target:
    try:
        return target.placed(parameters)
    except ModelError as error:
        raise CalibrationError(
            f"estimate_channels: the {target.kind} does not explain the capture: its fit leads to "
            f"where none can stand ({error})"
        ) from error


def _check_sense(pairs: Pairs, seen: np.ndarray, target: Target) -> None:
    left = np.square(np.abs(pairs.mean - pairs.model)[seen]).sum()
    if not left <= np.square(np.abs(pairs.mean[seen])).sum():
        raise CalibrationError(
            f"estimate_channels: the {target.kind} does not explain the capture: taking its echoes "
            "off leaves more than there was. Another target, or another place"
        )


def _check_range(target: Target, said: np.ndarray, tolerance: np.ndarray) -> None:
    off = (target.parameters - said) / tolerance
    worst = int(np.abs(off).argmax())
    if abs(off[worst]) > CAPTURE_RANGE:
        name, unit = target.parameter_names[worst].rsplit("_", 1)
        scale, unit = (1e3, "mm") if unit == "m" else (1.0, "degrees")
        raise CalibrationError(
            f"estimate_channels: the {target.kind} is not where it was said to be, or is another: "
            f"expected {name} {scale * said[worst]:.4g} {unit} within "
            f"{CAPTURE_RANGE * scale * tolerance[worst]:.3g} {unit}, the fit leads "
            f"{scale * off[worst] * tolerance[worst]:+.3g} {unit} away and on"
        )

"""Diagnosis of a capture's convention by image sharpness under sixteen hypotheses.

Sharpness is the sum of |V|^4, the squared intensity: R. A. Muller, A. Buffington, "Real-time
correction of atmospherically degraded telescope images through image sharpening", JOSA 64(9), 1974,
doi 10.1364/JOSA.64.001200.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.conventions.hypotheses import HYPOTHESES, MIRROR_X, Hypothesis, apply_convention
from calibration.conventions.position_scale import (
    FOCUSED_DB,
    SPECKLE_CONTRAST_DB,
    UNITS,
    contrast_db,
    plausible_scales,
    with_scaled_positions,
)
from calibration.conventions.search_region import scene_paths_m, search_grids, window_of
from calibration.conventions.tx_rx_symmetry import SwapIsometry, swap_isometry, swap_sigma
from calibration.conventions.wavefront_curvature import curvature_sigma
from clradar.backproject import backproject
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ModelError, warn
from clradar.model import Capture, DepthMap, Volume, VoxelGrid, checks
from clradar.model.plausible import place
from clradar.model.progress import Progress
from clradar.model.range_profile import MIN_STEPS, antenna_subset, range_profile
from clradar.model.resolution import lateral_resolution_m
from clradar.opencl import Device, open_device

CURVATURE_SIGMA = 6.0
"""Threshold above which the curvature of the wavefronts decides the sign of range."""

SWAP_SIGMA = 6.0
"""Threshold above which the few antennas that break the symmetry decide whether Tx and Rx are
swapped. Point targets reach 16 and more, always of the right sign; plates, which no points
describe, up to 3 of either sign."""

MARGIN_DB = 2.5
"""Hypotheses whose sharpness is this close to the best remain. On plates, which focus least, a
wrong one was 1.8 dB ahead with antennas three wavelengths apart."""

NOISE_SPREADS = 5.0
"""The margin is at least this many standard deviations of the sharpness of pure noise."""

GAUSSIAN_FOURTH_MOMENT_SPREAD = float(np.sqrt(20.0) / 2.0)
"""Standard deviation over mean of |V|^4, V circular Gaussian: E|V|^8 = 24, (E|V|^4)^2 = 4."""

FAST_FROM_TERMS = 2e8
"""Pairs times voxels of an image from which on the fast one is formed. It takes some tenths of a
second whatever the size of so coarse a grid; below, range profiles take less."""

MOST_TERMS = 8e9
"""Pairs times voxels of all images; beyond that a subset of the antennas is used."""

BRIGHT_DB = 15.0
MOST_POINTS = 200
"""Image points used by the test for swapped axes: within `BRIGHT_DB`, at most this many."""

EXPECTED_WITHIN_M = 0.020
"""Tolerance s of a known target's position: amplitude is weighted by exp(-distance^2 / 2 s^2)."""

EXPECTED_BOX_M = 0.040
EXPECTED_MARGIN_DB = 3.0
EXPECTED_FLOOR_DB = -20.0
"""Known target: margin over its mirror images, and level relative to the image's maximum."""


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """The image of the capture under one hypothesis.

    Attributes
    ----------
    hypothesis : Hypothesis
    sharpness : float
        Sum of ``|V|^4`` over the image, relative to the sharpest that the sign of range allows. NaN
        for an impossible hypothesis.
    peak_m : ndarray, shape (3,), metres
        Brightest voxel, x, y, z. NaN for an impossible hypothesis.
    image : DepthMap or None
        Amplitude over x and y; None for an impossible hypothesis.

    Examples
    --------
    >>> import numpy as np
    >>> from clradar import calibration
    >>> score = calibration.Score(calibration.Hypothesis(), 0.5, np.array([0, 0, 0.3]), None)
    >>> round(score.relative_db, 2)
    -3.01
    """

    hypothesis: Hypothesis
    sharpness: float
    peak_m: np.ndarray
    image: DepthMap | None

    def __post_init__(self) -> None:
        peak = checks.read_only("Score.peak_m", self.peak_m, np.float64, (3,), finite=False)
        object.__setattr__(self, "peak_m", peak)

    @property
    def relative_db(self) -> float:
        """10 log10 of the sharpness, decibel; NaN for an impossible hypothesis."""
        if not self.sharpness > 0:
            return float("nan") if np.isnan(self.sharpness) else float("-inf")
        return float(10 * np.log10(self.sharpness))


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """The conventions that a capture and its array are consistent with.

    Attributes
    ----------
    scores : tuple of Score
        All sixteen, in the order of `HYPOTHESES`.
    best : Hypothesis or None
        The candidate with the fewest changes. None if undecidable: no echo, or candidates remain
        that differ by more than a symmetry of the array.
    candidates : tuple of Hypothesis
        The hypotheses that remain, `best` first; empty without an echo.
    reasons : tuple of str
        One sentence for each decision not made by sharpness, and each that could not be made.
    recommendation : str
        What to change, in words.
    margin_db : float
        Hypotheses within this of the sharpest remain.
    curvature_sigma, swap_sigma : float or None
        The two test statistics, where they were evaluated: see docs/diagnose.md.
    position_scale : float
        What all antenna positions were multiplied by for all of this. Other than 1 if nothing could
        be decided with the positions as they are, and they seem to be in another unit.

    Examples
    --------
    >>> import clradar
    >>> from clradar import calibration
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0.01, 0, 0]])
    >>> zero = clradar.Capture([[[0j]]], array, clradar.Waveform([77e9]))
    >>> found = calibration.diagnose(zero)
    >>> found.best, found.decided, found.recommendation
    (None, False, 'Undecidable: the capture is zero everywhere.')
    """

    scores: tuple[Score, ...]
    best: Hypothesis | None
    candidates: tuple[Hypothesis, ...]
    reasons: tuple[str, ...]
    recommendation: str
    margin_db: float
    curvature_sigma: float | None
    swap_sigma: float | None
    position_scale: float = 1.0

    @property
    def decided(self) -> bool:
        """Whether a single hypothesis remains."""
        return len(self.candidates) == 1

    def score(self, hypothesis: Hypothesis) -> Score:
        return self.scores[HYPOTHESES.index(hypothesis)]

    def to_dict(self) -> dict[str, Any]:
        """Everything but the images in types that JSON has; None stands for NaN."""

        def named(h: Hypothesis) -> dict[str, Any]:
            return {"label": h.label, **{n: bool(getattr(h, n)) for n in Hypothesis.__slots__}}

        scaled = {} if self.position_scale == 1 else {"position_scale": self.position_scale}
        return {
            **scaled,
            "best": None if self.best is None else named(self.best),
            "decided": self.decided,
            "candidates": [named(h) for h in self.candidates],
            "reasons": list(self.reasons),
            "recommendation": self.recommendation,
            "margin_db": self.margin_db,
            "curvature_sigma": self.curvature_sigma,
            "swap_sigma": self.swap_sigma,
            "hypotheses": [
                {
                    **named(s.hypothesis),
                    "relative_db": s.relative_db if np.isfinite(s.relative_db) else None,
                    "peak_m": s.peak_m.tolist() if np.isfinite(s.peak_m).all() else None,
                }
                for s in self.scores
            ],
        }


def diagnose(
    capture: Capture,
    *,
    grid: VoxelGrid | None = None,
    expected_m: Sequence[float] | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find out in which of sixteen conventions a capture was written.

    Parameters
    ----------
    capture : Capture
        Antenna positions and frequencies are right, except for the changes of a `Hypothesis`.
    grid : VoxelGrid, optional
        Voxels to image; symmetric about x = 0, and coarse: eight images are formed, from a subset
        of the antennas if that is too much work (`MOST_TERMS`). Default: around the strongest echo
        beyond the direct coupling.
    expected_m : three floats, metres, optional
        Rough position of a known target, x, y, z, within some 20 mm: it distinguishes an image from
        its mirror images, which are as sharp.
    device : Device, str or None
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ModelError
        A grid that is not symmetric about x = 0; no grid, and a waveform whose range profile cannot
        find the scene; a position that is not three numbers, or behind the antennas.
    DeviceError
        See `clradar.backproject`.

    Warns
    -----
    ClradarWarning
        The antenna positions seem to be in another unit; the result is for positions times its
        `position_scale`.

    Examples
    --------
    >>> import clradar, numpy as np
    >>> from clradar import calibration
    >>> from clradar import reference
    >>> place = np.random.default_rng(4)
    >>> tx, rx = (np.c_[place.uniform(-0.07, 0.07, (12, 2)), np.zeros(12)] for _ in range(2))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> capture = reference.point_targets(
    ...     clradar.AntennaArray(tx, rx), waveform, [[0.03, -0.05, 0.3]], [1.0])
    >>> wrong = calibration.apply_convention(capture, calibration.Hypothesis(conjugated=True))
    >>> grid = clradar.VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.28, 0.32), 4e-3)
    >>> found = calibration.diagnose(wrong, grid=grid, device="pocl")
    >>> [hypothesis.label for hypothesis in found.candidates]
    ['conjugated', 'conjugated, mirrored']
    """
    checks.instance("diagnose: capture", capture, Capture)
    if grid is not None:
        checks.instance("diagnose: grid", grid, VoxelGrid)
        if abs(grid.x_m[0] + grid.x_m[-1]) > 1e-6 * grid.spacing_m[0]:
            checks.fail(
                "diagnose: grid",
                "as far to the left as to the right of x = 0, since mirrored images are formed",
                f"x from {grid.x_m[0]:g} to {grid.x_m[-1]:g} m",
            )
    expected = None
    if expected_m is not None:
        expected = place("diagnose: expected_m", expected_m)
        if expected[2] <= 0:
            checks.fail("diagnose: expected_m", "a position with z > 0", expected.tolist())
    if not capture.data.any():
        return _nothing("the capture is zero everywhere")
    search = _Search(capture, open_device(device), progress)
    found = search.run(grid, expected)
    return found if found.best is not None else _in_other_units(search, found, grid, expected)


def _in_other_units(
    search: _Search, found: Diagnosis, grid: VoxelGrid | None, expected: np.ndarray | None
) -> Diagnosis:
    """Return what is decided with positions in another unit, if that focuses; else `found`."""
    best = found
    focus_db = FOCUSED_DB
    for scale in plausible_scales(search.capture):
        scaled = with_scaled_positions(search.capture, scale)
        other = _Search(scaled, search.device, search.progress)
        result = other.run(grid, expected)
        if result.best is None or other.contrast_db < focus_db:
            continue
        focus_db = other.contrast_db
        reason = (
            f"positions: as they are nothing is decided, and with all of them times {scale:g} the "
            f"image focuses (contrast {other.contrast_db:.0f} dB; 3 dB is speckle): they seem to "
            f"be {UNITS[scale]}"
        )
        advice = (
            f"Multiply all antenna positions by {scale:g}: they seem to be {UNITS[scale]}. Then: "
        )
        best = replace(
            result,
            reasons=(reason, *result.reasons),
            recommendation=advice + result.recommendation,
            position_scale=scale,
        )
    if best.position_scale != 1:
        warn(
            f"diagnose: the antenna positions seem to be {UNITS[best.position_scale]}; the result "
            f"holds for positions times {best.position_scale:g}. Correct the unit where the file "
            "is read (the layout's 'unit'), or give apply_convention this position_scale"
        )
    return best


def _nothing(reason: str) -> Diagnosis:
    scores = tuple(Score(h, float("nan"), np.full(3, np.nan), None) for h in HYPOTHESES)
    text = f"Undecidable: {reason}."
    return Diagnosis(scores, None, (), (reason,), text, MARGIN_DB, None, None)


class _Search:
    """State shared by the steps of one diagnosis."""

    def __init__(self, capture: Capture, device: Device, progress: Progress | None) -> None:
        self.capture, self.device, self.progress = capture, device, progress
        self.array = capture.array
        self.window = window_of(capture.waveform)
        self.possible = [
            h for h in HYPOTHESES if not (h.swapped and self.array.n_tx != self.array.n_rx)
        ]
        self.reasons: list[str] = []
        self.curvature: float | None = None
        self.swap: float | None = None
        self.contrast_db = SPECKLE_CONTRAST_DB

    def run(self, grid: VoxelGrid | None, expected: np.ndarray | None) -> Diagnosis:
        grids = self._grids() if grid is None else [grid]
        if not grids:
            return _nothing(
                "no echo stands out of the noise beyond the direct coupling of Tx and Rx"
            )
        imaged = self._imaged(grids)
        volumes = self._images(imaged, grids)
        moments = {h: _sharpness(v) for h, v in volumes.items()}
        open_ones = [h for h in self.possible if self._sign_fits(h)]
        sharpest = max(open_ones, key=lambda h: moments[h.without_mirror()]).without_mirror()
        self.contrast_db = contrast_db(volumes[sharpest])
        top = moments[sharpest]
        if top == 0:
            return _nothing("no hypothesis shows anything within the grid")
        relative = {h: moments[h.without_mirror()] / top for h in self.possible}
        margin_db = max(_margin_db(imaged, g) for g in grids)
        left = [h for h in open_ones if relative[h] >= 10 ** (-margin_db / 10)]
        scores = tuple(self._score(h, relative, volumes) for h in HYPOTHESES)
        if self.array.n_tx != self.array.n_rx:
            self.reasons.append(
                f"Tx and Rx cannot be swapped: there are {self.array.n_tx} and {self.array.n_rx}"
            )
        left = self._without_swap(left, volumes)
        left = self._expected(left, volumes, expected)
        return self._verdict(left, scores, margin_db)

    def _grids(self) -> list[VoxelGrid]:
        """Search grids for either sign of range, or for the one the wavefront curvature shows."""
        n_freq = self.capture.waveform.n_freq
        if n_freq < MIN_STEPS:
            raise ModelError(
                f"diagnose: expected a grid (--z-mm), since {n_freq} frequencies have no range "
                f"profile to find the scene in; {MIN_STEPS} would"
            )
        found = []
        for sign in (Hypothesis(), Hypothesis(conjugated=True)):
            corrected = apply_convention(self.capture, sign)
            profile = range_profile(corrected)
            paths_m = scene_paths_m(corrected, profile)
            if len(paths_m):
                found.append((sign, corrected, profile, paths_m))
        if not found:
            return []
        sign, corrected, profile, paths_m = found[0]
        power = np.interp(paths_m, profile.path_m, profile.power, period=profile.path_m[-1])
        self.curvature = curvature_sigma(corrected, float(paths_m[power.argmax()]))
        if sign.conjugated:
            self.curvature = -self.curvature
        if abs(self.curvature) >= CURVATURE_SIGMA:
            negative = self.curvature < 0
            found = [f for f in found if f[0].conjugated == negative] or found
            half = "negative" if self.curvature < 0 else "positive"
            self.reasons.append(
                f"delays, taken as they are in the file, are {half}: so the wavefronts curve, by "
                f"{abs(self.curvature):.0f} standard errors"
            )
        return [g for _, corrected, _, paths_m in found for g in search_grids(corrected, paths_m)]

    def _sign_fits(self, h: Hypothesis) -> bool:
        """Whether the wavefront curvature is consistent with a hypothesis' sign of range."""
        if self.curvature is None or abs(self.curvature) < CURVATURE_SIGMA:
            return True
        return (h.conjugated != h.reversed) == (self.curvature < 0)

    def _imaged(self, grids: list[VoxelGrid]) -> Capture:
        """The capture, of a subset of the antennas if all were too much work for these grids."""
        voxels = sum(float(np.prod(grid.counts)) for grid in grids)
        images = sum(not h.mirrored for h in self.possible)
        return antenna_subset(self.capture, MOST_TERMS / (voxels * images))

    def _images(self, imaged: Capture, grids: list[VoxelGrid]) -> dict[Hypothesis, Volume]:
        """The sharpest image, over the grids, under each hypothesis without mirroring."""
        wanted = [h for h in self.possible if not h.mirrored]
        out: dict[Hypothesis, Volume] = {}
        for i, h in enumerate(wanted):
            corrected = apply_convention(imaged, h)
            best = -1.0
            for grid in grids:
                volume = self._image(corrected, grid)
                sharpness = _sharpness(volume)
                if sharpness > best:
                    out[h], best = volume, sharpness
            if self.progress is not None:
                self.progress(i + 1, len(wanted))
        return out

    def _image(self, capture: Capture, grid: VoxelGrid) -> Volume:
        array = capture.array
        terms = array.n_tx * array.n_rx * float(np.prod(grid.counts))
        method = "fast" if terms >= FAST_FROM_TERMS else "range"
        return backproject(
            capture, grid, method=method, window=self.window, check_grid=False, device=self.device
        )

    def _score(
        self, h: Hypothesis, relative: dict[Hypothesis, float], volumes: dict[Hypothesis, Volume]
    ) -> Score:
        if h not in relative:
            return Score(h, float("nan"), np.full(3, np.nan), None)
        volume = volumes[h.without_mirror()]
        z, y, x = np.unravel_index(int(np.abs(volume.data).argmax()), volume.data.shape)
        grid = volume.grid
        peak = np.array([grid.x_m[x], grid.y_m[y], grid.z_m[z]])
        image = volume.depth_map()
        if h.mirrored:
            peak = peak * MIRROR_X
            image = replace(
                image,
                depth_m=image.depth_m[:, ::-1],
                amplitude=image.amplitude[:, ::-1],
                x_m=-image.x_m[::-1],
            )
        return Score(h, relative[h], peak, image)

    def _without_swap(
        self, left: list[Hypothesis], volumes: dict[Hypothesis, Volume]
    ) -> list[Hypothesis]:
        """Drop the hypotheses that the test for swapped axes rejects, where it is applicable."""
        pairs = [h for h in left if not h.swapped and replace(h, swapped=True) in left]
        if not pairs:
            return left
        wavelength_m = SPEED_OF_LIGHT_M_PER_S / self.capture.waveform.center_hz
        isometry = swap_isometry(self.array, wavelength_m)
        if isometry is None:
            self.reasons.append("swapped axes: both images are as sharp, within the margin")
            return left
        words = _in_words(isometry)
        if isometry.exact:
            self.reasons.append(
                f"swapped axes: {words} maps every Tx on an Rx and every Rx on a Tx, so the scene "
                "moved in this way would give the same data"
            )
            return left
        signs = {h.without_mirror() for h in pairs}
        count = int(isometry.moved_tx.sum() + isometry.moved_rx.sum())
        near = f"{words} maps all antennas on each other but {count} of {2 * self.array.n_tx}"
        if len(signs) > 1:
            self.reasons.append(f"swapped axes: {near}, and phase sign or order are not known")
            return left
        sign = signs.pop()
        points_m = _bright_points_m(volumes[sign])
        corrected = apply_convention(self.capture, sign)
        self.swap = swap_sigma(corrected, isometry, points_m)
        if abs(self.swap) < SWAP_SIGMA:
            self.reasons.append(
                f"swapped axes: {near}, and their {abs(self.swap):.1f} standard errors for "
                f"{'swapped' if self.swap < 0 else 'not swapped'} are below {SWAP_SIGMA:g}"
            )
            return left
        self.reasons.append(
            f"swapped axes: {near}, but these decide by {abs(self.swap):.0f} standard errors"
        )
        return [h for h in left if h.swapped == (self.swap < 0)]

    def _expected(
        self,
        left: list[Hypothesis],
        volumes: dict[Hypothesis, Volume],
        expected: np.ndarray | None,
    ) -> list[Hypothesis]:
        """Keep the hypotheses whose image has an echo at the known position of a target."""
        if expected is None:
            return left
        levels_db = []
        for h in left:
            at = expected * MIRROR_X if h.mirrored else expected
            corrected = apply_convention(self.capture, h.without_mirror())
            level = self._level_near(corrected, at)
            whole = float(np.abs(volumes[h.without_mirror()].data).max())
            levels_db.append(20 * np.log10(max(level / whole, 1e-12)))
        top_db = max(levels_db)
        place = ", ".join(f"{1e3 * v:g}" for v in expected)
        if top_db < EXPECTED_FLOOR_DB:
            self.reasons.append(f"nothing is near the expected position ({place}) mm")
            return left
        kept = [
            h
            for h, level_db in zip(left, levels_db, strict=True)
            if level_db > top_db - EXPECTED_MARGIN_DB
        ]
        if len(kept) < len(left):
            self.reasons.append(f"the target at ({place}) mm is there under {_listed(kept)} only")
        else:
            self.reasons.append(f"the position ({place}) mm is as good under all of them")
        return kept

    def _level_near(self, capture: Capture, at: np.ndarray) -> float:
        """Largest amplitude near a position, weighted by the distance from it."""
        step_m = [
            min(lateral_resolution_m(capture, axis, float(at[2])) / 2, EXPECTED_BOX_M)
            for axis in (0, 1)
        ]
        span_hz = capture.waveform.span_hz
        cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * span_hz) if span_hz > 0 else EXPECTED_BOX_M
        steps = np.array([*step_m, min(cell_m / 2, EXPECTED_BOX_M)])
        half = np.ceil(EXPECTED_BOX_M / steps).astype(int)
        grid = VoxelGrid(at - half * steps, steps, tuple(int(n) for n in 2 * half + 1))  # type: ignore[arg-type]
        volume = self._image(capture, grid)
        z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij", sparse=True)
        away2 = (x - at[0]) ** 2 + (y - at[1]) ** 2 + (z - at[2]) ** 2
        return float((np.abs(volume.data) * np.exp(-away2 / (2 * EXPECTED_WITHIN_M**2))).max())

    def _verdict(
        self, left: list[Hypothesis], scores: tuple[Score, ...], margin_db: float
    ) -> Diagnosis:
        left = sorted(left, key=lambda h: (h.changes, h))
        one_frequency = self.capture.waveform.n_freq == 1
        if one_frequency:
            self.reasons.append("frequency order: there is one frequency, which has none")
        if any(h.mirrored for h in left) and any(not h.mirrored for h in left):
            self.reasons.append(
                "mirrored x: a mirror is an isometry of space, so the image of any array is "
                "mirrored and exactly as sharp; only a target whose position is known tells"
            )
        distinct = {(h.conjugated, h.reversed and not one_frequency) for h in left}
        undecided = len(distinct) > 1
        best = None if undecided else left[0]
        if undecided:
            self.reasons.append(
                f"{len(distinct)} combinations of phase sign and frequency order are equally sharp "
                f"within {margin_db:.1f} dB: noise, a scene or antennas that do not focus, or "
                "channels that are not calibrated"
            )
        text = _recommendation(best, left)
        return Diagnosis(
            scores,
            best,
            tuple(left),
            tuple(self.reasons),
            text,
            margin_db,
            self.curvature,
            self.swap,
        )


def _sharpness(volume: Volume) -> float:
    return float((np.abs(volume.data).astype(np.float64) ** 4).sum())


def _margin_db(capture: Capture, grid: VoxelGrid) -> float:
    """Margin of sharpness that pure noise does not exceed by chance."""
    range_m = float(grid.z_m.mean())
    cells = 1.0
    for axis, ends in enumerate((grid.x_m, grid.y_m)):
        cells *= 1 + float(ends[-1] - ends[0]) / lateral_resolution_m(capture, axis, range_m)
    span_hz = capture.waveform.span_hz
    planes = 1 + float(grid.z_m[-1] - grid.z_m[0]) * span_hz / SPEED_OF_LIGHT_M_PER_S
    pairs = capture.array.n_tx * capture.array.n_rx
    spread = GAUSSIAN_FOURTH_MOMENT_SPREAD / np.sqrt(min(cells, pairs) * planes)
    return max(MARGIN_DB, float(10 * np.log10(1 + NOISE_SPREADS * np.sqrt(2) * spread)))


def _bright_points_m(volume: Volume) -> np.ndarray:
    """Brightest voxel centres, shape (n, 3), metres."""
    amplitude = np.abs(volume.data).ravel()
    pick = np.argsort(amplitude)[-MOST_POINTS:]
    pick = pick[amplitude[pick] >= amplitude.max() * 10 ** (-BRIGHT_DB / 20)]
    z, y, x = np.unravel_index(pick, volume.data.shape)
    grid = volume.grid
    return np.stack([grid.x_m[x], grid.y_m[y], grid.z_m[z]], axis=1)


def _in_words(isometry: SwapIsometry) -> str:
    matrix = isometry.matrix
    for sign, line in ((1.0, "x = y"), (-1.0, "x = -y")):
        if np.allclose(matrix, [[0.0, sign, 0.0], [sign, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-6):
            return f"a mirror at the diagonal {line}"
    if np.allclose(matrix, np.eye(3), atol=1e-6):
        return "no motion at all" if np.abs(isometry.shift_m).max() < 1e-6 else "a shift"
    return "a reflection" if np.linalg.det(matrix) < 0 else "a rotation"


CHANGES = {
    "swapped": "the axes are [rx, tx, freq]",
    "conjugated": "the phase is exp(+j 2 pi f d / c)",
    "reversed": "the data runs from the highest frequency to the lowest",
    "mirrored": "x of the antennas is positive to the other side (negate every x)",
}
"""What the reader of the file has to assume, for each change of a hypothesis."""


def _recommendation(best: Hypothesis | None, left: Sequence[Hypothesis]) -> str:
    if best is None:
        return "Undecidable: " + _listed(left) + " are equally sharp."
    changes = [text for name, text in CHANGES.items() if getattr(best, name)]
    if changes:
        text = "Change the convention that the reader assumes: " + "; ".join(changes) + "."
    else:
        text = "Nothing to change: the capture is in clradar's convention."
    others = [h for h in left if h != best]
    if others:
        text += f" Equally sharp within the noise: {_listed(others)}."
    return text


def _listed(hypotheses: Sequence[Hypothesis]) -> str:
    return " / ".join(f"'{h.label}'" for h in hypotheses)

"""Which convention a capture was written in: a coarse image under each of sixteen hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.conventions.hypotheses import HYPOTHESES, MIRROR_X, Hypothesis, apply_convention
from calibration.conventions.search_region import (
    MIN_STEPS,
    lateral_resolution_m,
    range_profile,
    scene_paths_m,
    search_grids,
    thinned,
    window_of,
)
from calibration.conventions.tx_rx_symmetry import SwapIsometry, swap_isometry, swap_sigma
from calibration.conventions.wavefront_curvature import curvature_sigma
from clradar.backproject import backproject
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ModelError
from clradar.model import Capture, DepthMap, Volume, VoxelGrid, checks
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device

CURVATURE_SIGMA = 6.0
"""From here on the curvature of the wavefronts decides the sign of range."""

SWAP_SIGMA = 6.0
"""From here on a few antennas decide whether Tx and Rx are swapped. On point targets they reach 16
and more, always rightly; on plates, which no points describe, up to 3, also wrongly."""

MARGIN_DB = 2.5
"""Hypotheses whose sharpness is this close to the best are not told apart by it. On plates, which
focus least, a wrong one came out 1.8 dB ahead with antennas three wavelengths apart."""

NOISE_SPREADS = 5.0
"""The margin is at least this many standard deviations of the sharpness of mere noise."""

GAUSSIAN_FOURTH_MOMENT_SPREAD = float(np.sqrt(20.0) / 2.0)
"""Standard deviation over mean of |V|^4, V circular Gaussian: E|V|^8 = 24, (E|V|^4)^2 = 4."""

METHOD = "range"
"""Of image formation. The fast one has a price per block of 8 mm, which so coarse a grid does not
fill: 1.5 times as slow with 94 x 94 antennas, 10 to 25 times with a few."""

MOST_TERMS = 8e9
"""Pairs times voxels of all images; beyond that some of the antennas have to do. Some 10 s on two
cores by range profiles."""

BRIGHT_DB = 15.0
MOST_POINTS = 200
"""Points of the image that tell about swapped axes: within `BRIGHT_DB`, at most so many."""

EXPECTED_WITHIN_M = 0.020
"""How rough the position of a known target may be: amplitude counts by exp(-distance^2 / 2 s^2)."""

EXPECTED_BOX_M = 0.040
EXPECTED_MARGIN_DB = 3.0
EXPECTED_FLOOR_DB = -20.0
"""Known target: how far it must stand out from its mirror images, and from the image's maximum."""


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """What one hypothesis makes of the capture.

    Attributes
    ----------
    hypothesis : Hypothesis
    sharpness : float
        Sum of |V|^4 over the image, over that of the sharpest that the sign of range allows. NaN
        where the hypothesis is impossible.
    peak_m : ndarray, shape (3,), metres
        Where the image is brightest, x, y, z. NaN where the hypothesis is impossible.
    image : DepthMap or None
        Amplitude over x and y; None where the hypothesis is impossible.
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
        """Sharpness below the sharpest, decibel: 10 log10. NaN where impossible."""
        if not self.sharpness > 0:
            return float("nan") if np.isnan(self.sharpness) else float("-inf")
        return float(10 * np.log10(self.sharpness))


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Which convention a capture was written in, as far as it and its antennas can tell.

    Attributes
    ----------
    scores : tuple of Score
        All sixteen, in the order of `HYPOTHESES`.
    best : Hypothesis or None
        Of the candidates the one that changes least. None where the capture does not tell: it holds
        nothing, or candidates remain that differ by more than the geometry explains.
    candidates : tuple of Hypothesis
        What cannot be told apart, `best` first; empty where the capture holds nothing.
    reasons : tuple of str
        One sentence for everything that was decided otherwise than by sharpness, or not at all.
    recommendation : str
        What to change, in words.
    margin_db : float
        Sharpness this close to the best does not decide.
    curvature_sigma, swap_sigma : float or None
        The two statistics, where they were formed: see docs/diagnose.md.
    """

    scores: tuple[Score, ...]
    best: Hypothesis | None
    candidates: tuple[Hypothesis, ...]
    reasons: tuple[str, ...]
    recommendation: str
    margin_db: float
    curvature_sigma: float | None
    swap_sigma: float | None

    @property
    def decided(self) -> bool:
        """Whether a single hypothesis is left."""
        return len(self.candidates) == 1

    def score(self, hypothesis: Hypothesis) -> Score:
        return self.scores[HYPOTHESES.index(hypothesis)]

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON can hold of it, images left out; metres, NaN as None."""

        def named(h: Hypothesis) -> dict[str, Any]:
            return {"label": h.label, **{n: bool(getattr(h, n)) for n in Hypothesis.__slots__}}

        return {
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
    """Say in which of sixteen conventions a capture was written.

    Parameters
    ----------
    capture : Capture
        With antenna positions and frequencies that are right, but for `Hypothesis`.
    grid : VoxelGrid, optional
        Where to look; as far to the left as to the right of x = 0, and coarse: every voxel is
        formed eight times, with fewer antennas if it becomes too much (`MOST_TERMS`). By default
        around the strongest echo beyond the direct coupling.
    expected_m : three floats, metres, optional
        Rough position of a known target, x, y, z, within some 20 mm: it tells an image from its
        mirror images, which are as sharp.
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
        expected = checks.read_only("diagnose: expected_m", expected_m, np.float64, (3,))
        if expected[2] <= 0:
            checks.fail("diagnose: expected_m", "a position with z > 0", expected.tolist())
    if not capture.data.any():
        return _nothing("the capture is zero everywhere")
    opened = open_device(device)
    return _Search(capture, opened, progress).run(grid, expected)


def _nothing(reason: str) -> Diagnosis:
    scores = tuple(Score(h, float("nan"), np.full(3, np.nan), None) for h in HYPOTHESES)
    text = f"Undecidable: {reason}."
    return Diagnosis(scores, None, (), (reason,), text, MARGIN_DB, None, None)


class _Search:
    """One diagnosis: what its steps share."""

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

    def run(self, grid: VoxelGrid | None, expected: np.ndarray | None) -> Diagnosis:
        grids = self._grids() if grid is None else [grid]
        if not grids:
            return _nothing(
                "no echo stands out of the noise beyond the direct coupling of Tx and Rx"
            )
        imaged = self._imaged(grids)
        volumes = self._images(imaged, grids)
        moments = {
            h: float((np.abs(v.data).astype(np.float64) ** 4).sum()) for h, v in volumes.items()
        }
        open_ones = [h for h in self.possible if self._sign_fits(h)]
        top = max(moments[h.without_mirror()] for h in open_ones)
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
        """Return where the scene is, for either sign of range unless the wavefronts tell it."""
        n_freq = self.capture.waveform.n_freq
        if n_freq < MIN_STEPS:
            raise ModelError(
                f"diagnose: expected a grid (--z-mm), since {n_freq} frequencies have no range "
                f"profile to find the scene in; {MIN_STEPS} would"
            )
        found = []
        for sign in (Hypothesis(), Hypothesis(conjugated=True)):
            seen = apply_convention(self.capture, sign)
            profile = range_profile(seen)
            paths_m = scene_paths_m(seen, profile)
            if len(paths_m):
                found.append((sign, seen, profile, paths_m))
        if not found:
            return []
        sign, seen, profile, paths_m = found[0]
        power = np.interp(paths_m, profile.path_m, profile.power, period=profile.path_m[-1])
        self.curvature = curvature_sigma(seen, float(paths_m[power.argmax()]))
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
        return [g for _, seen, _, paths_m in found for g in search_grids(seen, paths_m)]

    def _sign_fits(self, h: Hypothesis) -> bool:
        """Whether the curvature of the wavefronts allows the sign of range of a hypothesis."""
        if self.curvature is None or abs(self.curvature) < CURVATURE_SIGMA:
            return True
        return (h.conjugated != h.reversed) == (self.curvature < 0)

    def _imaged(self, grids: list[VoxelGrid]) -> Capture:
        """Return the capture, of some of the antennas if all were too many for these grids."""
        voxels = sum(float(np.prod(grid.counts)) for grid in grids)
        images = sum(not h.mirrored for h in self.possible)
        return thinned(self.capture, MOST_TERMS / (voxels * images))

    def _images(self, imaged: Capture, grids: list[VoxelGrid]) -> dict[Hypothesis, Volume]:
        """Return the sharpest image, over the grids, under each hypothesis that does not mirror."""
        wanted = [h for h in self.possible if not h.mirrored]
        out: dict[Hypothesis, Volume] = {}
        for i, h in enumerate(wanted):
            seen = apply_convention(imaged, h)
            best = -1.0
            for grid in grids:
                volume = backproject(
                    seen, grid, method=METHOD, window=self.window, device=self.device
                )
                moment = float((np.abs(volume.data).astype(np.float64) ** 4).sum())
                if moment > best:
                    out[h], best = volume, moment
            if self.progress is not None:
                self.progress(i + 1, len(wanted))
        return out

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
        """Drop, where the antennas tell, the hypotheses that are wrong about swapped axes."""
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
        told = {h.without_mirror() for h in pairs}
        count = int(isometry.moved_tx.sum() + isometry.moved_rx.sum())
        near = f"{words} maps all antennas on each other but {count} of {2 * self.array.n_tx}"
        if len(told) > 1:
            self.reasons.append(f"swapped axes: {near}, and phase sign or order are not known")
            return left
        as_is = told.pop()
        points_m = _bright_points_m(volumes[as_is])
        seen = apply_convention(self.capture, as_is)
        self.swap = swap_sigma(seen, isometry, points_m)
        if abs(self.swap) < SWAP_SIGMA:
            self.reasons.append(
                f"swapped axes: {near}, and these say {abs(self.swap):.1f} standard errors for "
                f"{'swapped' if self.swap < 0 else 'not swapped'}, which is too little"
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
        """Keep the hypotheses under which something is where a target is known to be."""
        if expected is None:
            return left
        levels_db = []
        for h in left:
            at = expected * MIRROR_X if h.mirrored else expected
            seen = apply_convention(self.capture, h.without_mirror())
            level = self._level_near(seen, at)
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
        """Return the largest amplitude near a position, less the farther from it."""
        step_m = [
            min(lateral_resolution_m(capture, axis, float(at[2])) / 2, EXPECTED_BOX_M)
            for axis in (0, 1)
        ]
        span_hz = capture.waveform.span_hz
        cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * span_hz) if span_hz > 0 else EXPECTED_BOX_M
        steps = np.array([*step_m, min(cell_m / 2, EXPECTED_BOX_M)])
        half = np.ceil(EXPECTED_BOX_M / steps).astype(int)
        grid = VoxelGrid(at - half * steps, steps, tuple(int(n) for n in 2 * half + 1))  # type: ignore[arg-type]
        volume = backproject(capture, grid, method=METHOD, window=self.window, device=self.device)
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


def _margin_db(capture: Capture, grid: VoxelGrid) -> float:
    """Return how far below the best the sharpness of mere noise does not fall by chance."""
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
    """Return the brightest voxel centres, shape (n, 3), metres."""
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
"""What to tell the reader of the file, for each of a hypothesis' parts."""


def _recommendation(best: Hypothesis | None, left: Sequence[Hypothesis]) -> str:
    if best is None:
        return "Undecidable: " + _listed(left) + " are equally sharp."
    said = [text for name, text in CHANGES.items() if getattr(best, name)]
    if said:
        text = "Change what the reader takes for granted: " + "; ".join(said) + "."
    else:
        text = "Nothing to change: the capture is in clradar's convention."
    others = [h for h in left if h != best]
    if others:
        text += f" Not told apart from it: {_listed(others)}."
    return text


def _listed(hypotheses: Sequence[Hypothesis]) -> str:
    return " / ".join(f"'{h.label}'" for h in hypotheses)

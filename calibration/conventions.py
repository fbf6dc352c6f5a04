"""In which convention a capture was written: the sharpness of its image under eight of them.

Sharpness is the sum of |V|^4, the squared intensity: R. A. Muller, A. Buffington, "Real-time
correction of atmospherically degraded telescope images through image sharpening", JOSA 64(9), 1974,
doi 10.1364/JOSA.64.001200.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from clradar.backproject import backproject
from clradar.model import Capture, DepthMap, Volume, VoxelGrid, checks
from clradar.model.plausible import place
from clradar.model.progress import Progress
from clradar.model.range_profile import (
    MIN_STEPS,
    NEAR_PATH_M,
    antenna_subset,
    beyond_coupling,
    echoes,
    range_profile,
)
from clradar.model.record import plain
from clradar.model.resolution import lateral_resolution_m
from clradar.opencl import Device, open_device

MIRROR_X = np.array([-1.0, 1.0, 1.0])

MARGIN_DB = 2.5
"""Conventions whose sharpness is this close to the best remain. On plates, which focus least, a
wrong one was 1.8 dB ahead with antennas three wavelengths apart; noise alone decided nothing."""

FAST_FROM_TERMS = 2e8
"""Pairs times voxels of an image from which on the fast one is formed. It takes some tenths of a
second whatever the size of so coarse a grid; below, range profiles take less."""

MOST_TERMS = 8e9  # pairs times voxels of all images; beyond, of a subset of the antennas

SCENE_POWER_SHARE, SCENE_PATH_M = 0.1, 0.2
"""Range bins within 10 dB of the strongest echo, and no farther from it, belong to the scene."""

VIEW = 0.4  # half width of the field of view over the range
VOXELS_PER_RESOLUTION = 1.5  # a peak between two loses at most 1.6 dB along either axis
MAX_PLANES = 24  # one per cell c / (2 span), of which the window's main lobe has four

EXPECTED_WITHIN_M = 0.020  # of a known target, along each axis
EXPECTED_MARGIN_DB, EXPECTED_FLOOR_DB = 3.0, -20.0
"""Known target: margin over other hypotheses, and level relative to the image's maximum."""


@dataclass(frozen=True, slots=True, order=True)
class Hypothesis:
    """How the convention of a file differs from that of clradar.

    Each of the four changes is its own inverse, and they commute.

    Attributes
    ----------
    swapped, conjugated, reversed, mirrored : bool
        What the file holds in each case: docs/diagnose.md.
    """

    swapped: bool = False
    conjugated: bool = False
    reversed: bool = False
    mirrored: bool = False

    @property
    def changes(self) -> int:
        """How many of the four there are."""
        return self.swapped + self.conjugated + self.reversed + self.mirrored

    @property
    def label(self) -> str:
        """The names of its changes, such as "swapped, mirrored"; "as it is" without any."""
        return ", ".join(n for n in self.__slots__ if getattr(self, n)) or "as it is"


HYPOTHESES = tuple(Hypothesis(*flags) for flags in product((False, True), repeat=3))
"""The eight that images tell apart, the unchanged convention first. A mirrored one is as sharp."""

CHANGES = {
    "swapped": "the axes are [rx, tx, freq]",
    "conjugated": "the phase is exp(+j 2 pi f d / c)",
    "reversed": "the data runs from the highest frequency to the lowest",
    "mirrored": "x of the antennas is positive to the other side (negate every x)",
}
"""What the reader of the file has to assume, for each change of a hypothesis."""


def apply_convention(capture: Capture, hypothesis: Hypothesis) -> Capture:
    """Apply the changes of a hypothesis to a capture, or undo them.

    The label is appended to ``meta["conventions_applied"]``.

    Examples
    --------
    >>> other = calibration.Hypothesis(conjugated=True, mirrored=True)
    >>> fixed = calibration.apply_convention(capture, other)
    >>> print(capture.array.tx_m[0, 0], fixed.array.tx_m[0, 0], fixed.meta["conventions_applied"])
    -0.1 0.1 ['conjugated, mirrored']
    """
    checks.instance("apply_convention: capture", capture, Capture)
    checks.instance("apply_convention: hypothesis", hypothesis, Hypothesis)
    if not hypothesis.changes:
        return capture
    array, data = capture.array, capture.data
    if hypothesis.swapped:
        if array.n_tx != array.n_rx:
            expected = "as many Tx as Rx to swap the axes of the data"
            checks.fail("apply_convention", expected, f"{array.n_tx} Tx and {array.n_rx} Rx")
        data = data.transpose(1, 0, 2)
    if hypothesis.conjugated:
        data = data.conj()
    if hypothesis.reversed:
        data = data[..., ::-1]
    if hypothesis.mirrored:
        array = replace(array, tx_m=array.tx_m * MIRROR_X, rx_m=array.rx_m * MIRROR_X)
    before = capture.meta.get("conventions_applied", [])
    meta = {**capture.meta, "conventions_applied": [*before, hypothesis.label]}
    return Capture(np.ascontiguousarray(data), array, capture.waveform, meta)


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """The image of the capture under one hypothesis.

    Attributes
    ----------
    hypothesis : Hypothesis
    relative_db : float
        10 log10 of the sharpness, the sum of ``|V|^4``, relative to the sharpest.
    peak_m : ndarray, shape (3,), metres
        Brightest voxel, x, y, z.
    image : DepthMap
    """

    hypothesis: Hypothesis
    relative_db: float
    peak_m: np.ndarray
    image: DepthMap


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """The conventions that a capture and its array are consistent with.

    Attributes
    ----------
    scores : tuple of Score
        In the order of `HYPOTHESES`, swapped axes only with as many Tx as Rx; empty without an
        echo.
    candidates : tuple of Hypothesis
        Those within 2.5 dB of the sharpest, fewest changes first; mirrored where a known
        target says so.
    best : Hypothesis or None
        The first candidate. None without an echo, or with candidates that differ in the sign of the
        phase or the order of frequencies.
    mirror_known : bool
        Whether a known target decided between the image and its mirror image.
    recommendation : str
        What to change, in words.
    """

    scores: tuple[Score, ...]
    candidates: tuple[Hypothesis, ...]
    best: Hypothesis | None
    mirror_known: bool
    recommendation: str

    @property
    def decided(self) -> bool:
        """Whether a single hypothesis remains, but for the mirror image."""
        return self.best is not None and len(self.candidates) == 1

    def to_dict(self) -> dict[str, Any]:
        """Everything but the images in types that JSON has, hypotheses by their labels."""
        scores = [
            {"label": s.hypothesis.label, "relative_db": s.relative_db, "peak_m": s.peak_m}
            for s in self.scores
        ]
        return {
            "best": self.best and self.best.label,
            "decided": self.decided,
            "mirror_known": self.mirror_known,
            "candidates": [h.label for h in self.candidates],
            "recommendation": self.recommendation,
            "hypotheses": plain(scores),
        }


def diagnose(
    capture: Capture,
    *,
    grid: VoxelGrid | None = None,
    expected_m: Sequence[float] | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find out in which of eight conventions a capture was written: docs/diagnose.md.

    Parameters
    ----------
    capture : Capture
        Antenna positions and frequencies are right, except for the changes of a `Hypothesis`.
    grid : VoxelGrid, optional
        Coarse: eight images are formed. Default: around the strongest echo beyond the direct
        coupling; fewer than 8 frequencies need a grid.
    expected_m : three floats, optional
        Position of a known target, within some 20 mm: it decides between images that are equally
        sharp, such as an image and its mirror image.

    Returns
    -------
    Diagnosis

    Examples
    --------
    >>> from clradar.reference import point_targets
    >>> place = np.random.default_rng(4)
    >>> tx, rx = (np.c_[place.uniform(-0.07, 0.07, (12, 2)), np.zeros(12)] for _ in range(2))
    >>> radar = clradar.AntennaArray(tx, rx), clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> capture = point_targets(*radar, [[0.03, -0.05, 0.3]], [1.0])
    >>> wrong = calibration.apply_convention(capture, calibration.Hypothesis(conjugated=True))
    >>> grid = clradar.VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.28, 0.32), 4e-3)
    >>> [hypothesis.label for hypothesis in calibration.diagnose(wrong, grid=grid).candidates]
    ['conjugated']
    """
    checks.instance("diagnose: capture", capture, Capture)
    if grid is not None:
        checks.instance("diagnose: grid", grid, VoxelGrid)
    expected = None
    if expected_m is not None:
        expected = place("diagnose: expected_m", expected_m)
        if expected[2] <= 0:
            checks.fail("diagnose: expected_m", "a position with z > 0", expected.tolist())
    if not capture.data.any():
        return _undecidable("the capture is zero everywhere")
    grids = search_grids(capture) if grid is None else [grid]
    if not grids:
        return _undecidable("no echo stands out of the noise beyond the coupling of Tx and Rx")
    opened = open_device(device)
    square = capture.array.n_tx == capture.array.n_rx
    possible = [h for h in HYPOTHESES if square or not h.swapped]
    voxels = sum(float(np.prod(own.counts)) for own in grids)
    imaged = antenna_subset(capture, MOST_TERMS / (voxels * len(possible)))
    volumes: dict[Hypothesis, Volume] = {}
    for done, h in enumerate(possible, start=1):
        images = (_image(apply_convention(imaged, h), own, opened) for own in grids)
        volumes[h] = max(images, key=_sharpness)
        if progress is not None:
            progress(done, len(possible))
    sharpness = np.array([_sharpness(volume) for volume in volumes.values()])
    if not sharpness.any():
        return _undecidable("no hypothesis shows anything within the grid")
    with np.errstate(divide="ignore"):
        relative_db = 10 * np.log10(sharpness / sharpness.max())
    scores = []
    for (h, volume), level_db in zip(volumes.items(), relative_db.tolist(), strict=True):
        z, y, x = np.unravel_index(int(np.abs(volume.data).argmax()), volume.data.shape)
        peak_m = np.array([volume.grid.x_m[x], volume.grid.y_m[y], volume.grid.z_m[z]])
        scores.append(Score(h, level_db, peak_m, volume.depth_map()))
    left = [score.hypothesis for score in scores if score.relative_db >= -MARGIN_DB]
    left.sort(key=lambda h: (h.changes, h))
    both = [replace(h, mirrored=mirrored) for h in left for mirrored in (False, True)]
    if expected is not None:
        floor = 10 ** (EXPECTED_FLOOR_DB / 20) * float(np.abs(volumes[left[0]].data).max())
        both = _with_target(capture, both, expected, floor, opened)
    mirror_known = len({h.mirrored for h in both}) == 1
    left = [h for h in both if not h.mirrored or replace(h, mirrored=False) not in both]
    one_frequency = capture.waveform.n_freq == 1
    undecided = len({(h.conjugated, h.reversed and not one_frequency) for h in left}) > 1
    best = None if undecided else left[0]
    text = _recommendation(best, left, mirror_known, expected is not None)
    return Diagnosis(tuple(scores), tuple(left), best, mirror_known, text)


def _undecidable(reason: str) -> Diagnosis:
    return Diagnosis((), (), None, False, f"Undecidable: {reason}.")


def search_grids(capture: Capture) -> list[VoxelGrid]:
    """Coarse grids around the strongest echo beyond the coupling, the nearer of either sign.

    None without an echo; every alias where the waveform is ambiguous below `NEAR_PATH_M`.
    """
    if (n := capture.waveform.n_freq) < MIN_STEPS:
        expected = f"a grid, since fewer than {MIN_STEPS} frequencies ({n}) show no ranges"
        checks.fail("diagnose", expected, "none")
    found = []
    for sign in (Hypothesis(), Hypothesis(conjugated=True)):
        corrected = apply_convention(capture, sign)
        beyond = beyond_coupling(corrected, range_profile(corrected))
        for first in echoes(corrected, beyond)[:1]:
            near = np.abs(beyond.path_m - beyond.path_m[first]) <= SCENE_PATH_M
            strong = beyond.power >= SCENE_POWER_SHARE * beyond.power[first]
            found.append(beyond.path_m[near & strong])
    period_m = 2 * capture.waveform.unambiguous_range_m
    if period_m > 2 * NEAR_PATH_M:
        found = sorted(found, key=lambda paths_m: float(paths_m[0]))[:1]
    return [
        _grid(capture, paths_m + i * period_m)
        for paths_m in found
        for i in range(1 + max(0, int((NEAR_PATH_M - paths_m[0]) // period_m)))
    ]


def _grid(capture: Capture, paths_m: np.ndarray) -> VoxelGrid:
    range_m, cell_m = float(paths_m[0] + paths_m[-1]) / 4, capture.waveform.range_resolution_m
    antennas = np.concatenate([capture.array.tx_m, capture.array.rx_m])
    half_m = max(VIEW * range_m, float(np.abs(antennas[:, :2]).max()))
    # The antennas are beside the voxel: half the path length exceeds the voxel's z.
    aside_m = np.hypot(half_m, np.sqrt((antennas[:, :2] ** 2).sum(axis=1).mean()))
    nearest_m = paths_m[0] / 2
    low_m = np.sqrt(max(nearest_m**2 - aside_m**2, (nearest_m / 2) ** 2)) - cell_m / 2
    high_m = paths_m[-1] / 2 + cell_m / 2
    planes = int(np.clip(np.ceil((high_m - low_m) / cell_m) + 1, 2, MAX_PLANES))
    cells_m = [lateral_resolution_m(capture, axis, range_m) for axis in (0, 1)]
    x, y = (max(1, int(np.ceil(half_m * VOXELS_PER_RESOLUTION / cell))) for cell in cells_m)
    return VoxelGrid(
        np.array([-half_m, -half_m, low_m + antennas[:, 2].mean()]),
        np.array([half_m / x, half_m / y, (high_m - low_m) / (planes - 1)]),
        (2 * x + 1, 2 * y + 1, planes),
    )


def _image(capture: Capture, grid: VoxelGrid, device: Device) -> Volume:
    terms = capture.array.n_tx * capture.array.n_rx * float(np.prod(grid.counts))
    method = "fast" if terms >= FAST_FROM_TERMS else "range"
    # As of a range profile: Hann against coupling, unless it would leave next to nothing.
    window = "hann" if capture.waveform.n_freq >= MIN_STEPS else "rect"
    return backproject(capture, grid, method=method, window=window, check_grid=False, device=device)


def _sharpness(volume: Volume) -> float:
    return float((np.abs(volume.data).astype(np.float64) ** 4).sum())


def _with_target(
    capture: Capture, left: list[Hypothesis], at_m: np.ndarray, floor: float, device: Device
) -> list[Hypothesis]:
    """Those with a known target where it is expected; all if none has an echo there."""
    cells_m = [lateral_resolution_m(capture, axis, float(at_m[2])) for axis in (0, 1)]
    cells_m.append(capture.waveform.range_resolution_m)
    half = np.ceil(2 * EXPECTED_WITHIN_M / np.array(cells_m)).astype(int).clip(1)
    counts = (2 * half + 1).tolist()
    grid = VoxelGrid(at_m - EXPECTED_WITHIN_M, EXPECTED_WITHIN_M / half, tuple(counts))
    images = (_image(apply_convention(capture, h), grid, device) for h in left)
    levels = [float(np.abs(image.data).max()) for image in images]
    least = 0.0 if max(levels) < floor else max(levels) / 10 ** (EXPECTED_MARGIN_DB / 20)
    return [h for h, level in zip(left, levels, strict=True) if level >= least]


def _recommendation(
    best: Hypothesis | None, left: Sequence[Hypothesis], mirror_known: bool, expected: bool
) -> str:
    listed = " / ".join(f"'{h.label}'" for h in left)
    if best is None:
        return (
            f"Undecidable: {listed} are equally sharp: noise, a scene or antennas that do not "
            "focus, channels that are not calibrated, or positions in another unit."
        )
    changes = [text for name, text in CHANGES.items() if getattr(best, name)]
    text = "Nothing to change: the capture is in clradar's convention"
    if changes:
        text = "Change the convention that the reader assumes: " + "; ".join(changes)
    if len(left) > 1:
        others = " / ".join(f"'{h.label}'" for h in left[1:])
        text += f". Equally sharp within the noise: {others}"
    if not mirror_known:
        why = "the position given does not tell" if expected else "only a known target tells"
        text += f". x may be mirrored: the mirror image is as sharp, and {why}"
    return text + "."

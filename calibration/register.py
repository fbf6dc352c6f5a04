"""Close the loop: place the mesh, simulate it there, and correct the place by what that shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.align_mesh import (
    COVARIANCE_RATIO,
    Located,
    aperture_of,
    depth_for_mesh,
    fine_image,
    locate,
)
from calibration.alignment import Alignment
from calibration.mesh_fit import MeshFit, first_brightness, fit_mesh
from calibration.mesh_image import Aperture
from calibration.rigid import moved, orthonormal
from calibration.surface import failure
from clradar import arrays
from clradar.backproject import backproject
from clradar.model import AntennaArray, Capture, Scene, Volume, Waveform, checks
from clradar.opencl import Device, open_device
from clradar.synthesize import simulate

TOLERANCE_M = 1e-4
"""Done when a round moves no visible point of the mesh by more than about this."""

MAX_ROUNDS = 10

ALPHA_STARTS = (0.3, 0.0, 0.6)
"""What the first rounds try where alpha is to be found."""

SAME_ALPHA = 0.1
"""Rounds whose alpha is this near to the last one's count for the correction."""

ALPHA_TOLERANCE = 0.03

REGISTERED_RATIO = 1.2
"""As `align_mesh.COVARIANCE_RATIO`, after the correction (docs/calibration.md)."""

LARGEST_CORRECTION_M = 10e-3
"""A simulation that is found this far from where it was put says that the fit is none."""

_FIT_STEPS = 50
_KNOTS_COMPARED = 6  # the last knot is where the mesh is hardly seen


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One turn of the loop.

    Attributes
    ----------
    transform : ndarray, shape (4, 4)
        Where the mesh was simulated.
    alpha : float or None
        With which alpha, where it was to be found.
    moved_m : float, metres
        How far the round moved the mesh: of its middle, or of points one radius off by the turn,
        whichever is more.
    """

    transform: np.ndarray
    alpha: float | None
    moved_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A mesh in its place, and what it looks like there.

    Attributes
    ----------
    alignment : Alignment
        measured = transform . mesh, at the last simulation.
    scene : Scene
        The mesh in its place, with the alpha of the last simulation.
    capture : Capture
    volume : Volume
        The last simulation, on the grid of the measured volume.
    rounds : tuple of Round
    converged : bool
        Whether the last round moved the mesh by less than the tolerance.
    """

    alignment: Alignment
    scene: Scene
    capture: Capture
    volume: Volume
    rounds: tuple[Round, ...]
    converged: bool


Callback = Callable[[Round], None]


def register(
    measured: Volume,
    mesh: Scene,
    *,
    fit_alpha: bool = False,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    samples_per_mm2: float | None = None,
    rays_per_sample: int | None = None,
    seed: int = 0,
    dynamic_range_db: float | None = None,
    search_deg: float = 45.0,
    min_inlier_share: float = 0.5,
    tolerance_m: float = TOLERANCE_M,
    max_rounds: int = MAX_ROUNDS,
    device: Device | str | None = None,
    callback: Callback | None = None,
) -> Registration:
    """Place a mesh where it was measured, and simulate it there.

    Parameters
    ----------
    measured : Volume
        Of the object, in the antenna frame.
    mesh : Scene
        Anywhere; with the alpha to simulate with.
    fit_alpha : bool
        Find one alpha for the whole mesh instead, from how the brightness falls with the angle.
    array : AntennaArray, optional
    waveform : Waveform, optional
        Of the measurement: the 94 x 94 imager and 72 to 82 GHz in 128 steps if not given.
    samples_per_mm2, rays_per_sample, seed
        As in `clradar.simulate`; each round has a seed of its own, `seed` and up.
    dynamic_range_db, search_deg, min_inlier_share
        As in `align_mesh`.
    tolerance_m : float, metres
    max_rounds : int
        Rounds before it stops unconverged.
    device : Device, str or None
    callback : callable, optional
        Called with every `Round`.

    Returns
    -------
    Registration

    Raises
    ------
    CompareError
        "could not align, because …", as `align_mesh`; or no ray of a simulation reaches a receiver,
        or a simulation does not look like the mesh either.
    ModelError
        An option is out of its range.

    Notes
    -----
    Let F be where the mesh fits the measurement, and G where it fits its own simulation at T. What
    the picture of the mesh does not know (interference, the curvature of glints) shifts both alike,
    so T is corrected to (G T^-1)^-1 F. Corrections of several rounds, each with its own seed, are
    averaged: their speckle is independent.
    """
    checks.instance("register: measured", measured, Volume)
    tolerance_m = checks.positive("register: tolerance_m", tolerance_m)
    max_rounds = checks.whole("register: max_rounds", max_rounds, 1)
    seed = checks.whole("register: seed", seed, 0)
    if waveform is not None:
        checks.instance("register: waveform", waveform, Waveform)
    radar = arrays.qar50() if array is None else array
    sweep = Waveform.sfcw(72e9, 82e9, 128) if waveform is None else waveform
    frequency_hz = float(np.mean(sweep.frequencies_hz))
    opened = open_device(device)
    located = locate(
        measured,
        mesh,
        array=radar,
        centre_frequency_hz=frequency_hz,
        dynamic_range_db=dynamic_range_db,
        search_deg=search_deg,
        min_inlier_share=min_inlier_share,
        max_iterations=_FIT_STEPS,
        device=opened,
        progress=None,
    )
    aperture = aperture_of(radar, frequency_hz)
    fitted, start_m = located.fit, located.fit.centre_m
    radius_m = _radius_m(mesh, fitted)
    transform = fitted.transform
    corrections: list[np.ndarray] = []
    alphas: list[float] = []
    profiles: list[np.ndarray] = []
    rounds: list[Round] = []
    converged = False
    while not converged and len(rounds) < max_rounds:
        alpha = _next_alpha(alphas, profiles, fitted.log_brightness) if fit_alpha else None
        scene = mesh.transformed(transform)
        if alpha is not None:
            scene = scene.with_alpha(alpha)
        capture = simulate(
            scene,
            radar,
            sweep,
            samples_per_mm2=samples_per_mm2,
            rays_per_sample=rays_per_sample,
            seed=seed + len(rounds),
            device=opened,
        )
        if capture.meta["rays"]["paths"] == 0:
            raise failure("no ray from the mesh at the place found reaches a receiver")
        volume = backproject(capture, measured.grid, device=opened)
        found = _found(volume, mesh, transform, located, dynamic_range_db, aperture, opened)
        corrections.append(_small(found.transform, transform, start_m))
        if np.linalg.norm(corrections[-1][3:]) > LARGEST_CORRECTION_M:
            raise failure(
                "the simulation at the place found does not look like the mesh: it fits "
                f"{1e3 * np.linalg.norm(corrections[-1][3:]):.1f} mm off"
            )
        if alpha is not None:
            alphas.append(alpha)
            profiles.append(_profile(found.log_brightness))
        mean = np.mean(_counting(corrections, alphas), axis=0)
        following = _corrected(fitted.transform, mean, start_m)
        step = _small(following, transform, start_m)
        moved_m = float(max(np.linalg.norm(step[3:]), radius_m * np.linalg.norm(step[:3])))
        settled = alpha is None or _settled(alphas, profiles, fitted.log_brightness)
        converged = moved_m < tolerance_m and settled
        rounds.append(Round(transform, alpha, moved_m))
        if callback is not None:
            callback(rounds[-1])
        last = transform
        transform = following
    alignment = located.alignment
    alignment = replace(
        alignment,
        transform=last,
        covariance=_narrowed(alignment, located),
        converged=converged,
        iterations=len(rounds),
    )
    return Registration(alignment, scene, capture, volume, tuple(rounds), converged)


def _radius_m(mesh: Scene, fit: MeshFit) -> float:
    vertices_m = moved(fit.transform, mesh.vertices_m[np.unique(mesh.faces)])
    return float(np.median(np.linalg.norm(vertices_m - fit.centre_m, axis=1)))


def _found(
    volume: Volume,
    mesh: Scene,
    transform: np.ndarray,
    located: Located,
    dynamic_range_db: float | None,
    aperture: Aperture,
    device: Device,
) -> MeshFit:
    """Return where the mesh fits its own simulation, started from where it was put."""
    depth = depth_for_mesh(volume, dynamic_range_db)
    held = located.held if located.held.shape[1] else None
    with fine_image(mesh, depth, aperture, device) as image:
        return fit_mesh(image, transform, first_brightness(), _FIT_STEPS, held)


def _small(there: np.ndarray, here: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Return the motion from `here` to `there` as rotation vector and shift of `at_m`, (6,)."""
    motion = there @ np.linalg.inv(here)
    turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return np.concatenate([turn, moved(motion, at_m[None])[0] - at_m])


def _corrected(fitted: np.ndarray, correction: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Return `fitted` moved against a motion as `_small` gives it."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(correction[:3]).as_matrix()
    motion[:3, 3] = at_m + correction[3:] - motion[:3, :3] @ at_m
    return orthonormal(np.linalg.inv(motion) @ fitted)


def _counting(corrections: list[np.ndarray], alphas: list[float]) -> list[np.ndarray]:
    """Return the corrections that count: not the first one, from a place farther off."""
    kept = [
        correction
        for i, correction in enumerate(corrections)
        if not alphas or abs(alphas[i] - alphas[-1]) <= SAME_ALPHA
    ]
    return kept[1:] if len(kept) > 2 else kept[-1:]


def _profile(log_brightness: np.ndarray) -> np.ndarray:
    return (log_brightness - log_brightness.max())[:_KNOTS_COMPARED]


def _next_alpha(
    alphas: list[float], profiles: list[np.ndarray], log_brightness: np.ndarray
) -> float:
    """Return the alpha whose brightness over angle, between those tried, is the measured one."""
    if len(alphas) < len(ALPHA_STARTS):
        return ALPHA_STARTS[len(alphas)]
    wanted = _profile(log_brightness)
    order = np.argsort(alphas, kind="stable")
    tried = np.array(alphas)[order]
    known = np.array(profiles)[order]
    best, least = tried[0], np.inf
    for low, high, at_low, at_high in zip(
        tried[:-1], tried[1:], known[:-1], known[1:], strict=True
    ):
        if high - low < 1e-6:
            continue
        along = at_high - at_low
        share = float(along @ (wanted - at_low) / max(along @ along, 1e-12))
        # Beyond what was tried only at the ends, and not far.
        least_share = -1.0 if low == tried[0] else 0.0
        most_share = 2.0 if high == tried[-1] else 1.0
        share = float(np.clip(share, least_share, most_share))
        apart = float(((at_low + share * along - wanted) ** 2).sum())
        if apart < least:
            best, least = low + share * (high - low), apart
    return float(np.clip(best, 0.0, 1.0))


def _settled(alphas: list[float], profiles: list[np.ndarray], log_brightness: np.ndarray) -> bool:
    if len(alphas) <= len(ALPHA_STARTS):
        return False
    return abs(_next_alpha(alphas, profiles, log_brightness) - alphas[-1]) < ALPHA_TOLERANCE


def _narrowed(alignment: Alignment, located: Located) -> np.ndarray:
    """Return the covariance after the correction; what is held stays unknown."""
    if located.held.shape[1]:
        return alignment.covariance
    return alignment.covariance * (REGISTERED_RATIO / COVARIANCE_RATIO) ** 2

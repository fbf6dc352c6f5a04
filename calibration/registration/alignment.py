"""Result of a registration: the motion, its covariance and its unobservable directions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.registration.beyond_noise import Place
from calibration.registration.rigid_motion import moved_back
from clradar.errors import warn
from clradar.model import checks
from clradar.model.record import plain

UNKNOWN_STD_M = 1.0
"""Standard deviation that `Alignment.covariance` carries along an unobservable direction."""

USUAL_OVERLAP = 0.85
"""On simulated measurements right meshes had 0.91 or more, wrong ones up to 0.94, most of them less
(docs/registration-method.md)."""

USUAL_RATIO = 2.0
"""Of the residuals to the noise: the right mesh had 0.6 to 1.5 in eight simulated measurements, one
with three fingers bent otherwise by 15 degrees 1.5 in one and 2.3 to 6 in nine
(docs/registration-method.md)."""

LARGEST = 1e9
"""Of the numbers of a matrix, in metres and radians and their squares: far beyond what stands in
front of a radar, and far from an overflow."""

IMAGE, MESH = "simulated image", "mesh"


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Rigid motion of a simulated depth map, or of a mesh, onto a measured one.

    docs/calibration.md has how to read it.

    Attributes
    ----------
    transform : ndarray, shape (4, 4), metres
        In the antenna frame: measured = transform . simulated, or mesh.
    rms_m : float
        Root mean square distance of the inliers, weighted by amplitude: of images along the
        measured normals, of a mesh along the line of sight.
    inlier_share : float
        Of the simulated amplitude on the measured surface, or of the measured one on the mesh.
    iterations : int
        Point-to-plane steps, or rounds of simulation.
    converged : bool
    covariance : ndarray, shape (6, 6)
        Of a further rotation vector (radians) and translation (metres) about `centre_m`, with a
        standard deviation of 1 m along `degenerate_directions`.
    degenerate_directions : tuple of str
        Unobservable, and constrained to no motion.
    centre_m : ndarray, shape (3,)
        Of the measured depth points, or of the mesh's visible surface after `transform`.
    moved : "simulated image" or "mesh"
    likeness, overlap : float or None
        Of a mesh: correlation of its rendering with the image, in decibels; overlap
        (docs/metrics.md) of its simulation there with the measurement.
    searched_deg : float or None
        Largest rotation about boresight of a mesh's search.
    residual_ratio : float or None
        Of the measurement's residuals to the scatter of simulations of the mesh: 1 is noise, more
        widens `covariance`. None with too few simulations.
    places : tuple of Place
        Where the residuals are largest, worst first.
    """

    transform: np.ndarray
    rms_m: float
    inlier_share: float
    iterations: int
    converged: bool
    covariance: np.ndarray
    degenerate_directions: tuple[str, ...]
    centre_m: np.ndarray
    moved: str = IMAGE
    likeness: float | None = None
    overlap: float | None = None
    searched_deg: float | None = None
    residual_ratio: float | None = None
    places: tuple[Place, ...] = ()

    def __post_init__(self) -> None:
        for name, shape in (("transform", (4, 4)), ("covariance", (6, 6)), ("centre_m", (3,))):
            field = f"Alignment.{name}"
            array = checks.read_only(field, getattr(self, name), np.float64, shape)
            largest = float(np.abs(array).max())
            if largest > LARGEST:
                checks.fail(field, f"numbers up to {LARGEST:g}", f"{largest:g}")
            object.__setattr__(self, name, array)
        check_rigid("Alignment.transform", self.transform)
        least = float(np.diag(self.covariance).min())
        if least < 0.0:
            checks.fail("Alignment.covariance", "variances of 0 or more", f"{least:g}")
        for name in ("rms_m", "inlier_share"):
            checks.real(f"Alignment.{name}", getattr(self, name))
        checks.one_of("Alignment.moved", self.moved, (IMAGE, MESH))

    @property
    def rotation_deg(self) -> float:
        """Angle of the rotation, 0 to 180."""
        return float(np.degrees(np.linalg.norm(self.rotation_vector)))

    @property
    def rotation_vector(self) -> np.ndarray:
        """Axis times angle of the rotation, shape (3,)."""
        return Rotation.from_matrix(self.transform[:3, :3].copy()).as_rotvec()

    @property
    def shift_m(self) -> np.ndarray:
        """Shift of the point that is moved to `centre_m`, shape (3,)."""
        return self.centre_m - moved_back(self.transform, self.centre_m)

    def to_dict(self) -> dict[str, Any]:
        """The result in types that JSON has."""
        return {**plain(self), "remarks": list(self.remarks()), "report": self.report()}

    def remarks(self) -> tuple[str, ...]:
        """Reasons to doubt the result, one clause each."""
        found = []
        if not self.converged:
            found.append(
                f"the pose still changed in the last iteration, number {self.iterations}, and may "
                "go on: more are needed (max_iterations; max_rounds of register, --max-rounds)"
            )
        if self.searched_deg is not None and self.rotation_deg > self.searched_deg:
            found.append(
                f"it is turned by {self.rotation_deg:.0f} deg, and rotations up to "
                f"{self.searched_deg:.0f} deg were searched: search up to 180 deg (search_deg, "
                "--search-deg)"
            )
        if self.overlap is not None and self.overlap < USUAL_OVERLAP:
            found.append(
                f"an overlap of {self.overlap:.2f} is little, right meshes have 0.91 or more in "
                "simulations: the object or its pose may be another"
            )
        if self.residual_ratio is not None and self.residual_ratio > USUAL_RATIO:
            worst = "; ".join(place.text() for place in self.places) or "no place in particular"
            found.append(
                f"the residuals are {self.residual_ratio:.1f} times what the noise explains: the "
                "mesh may be posed or shaped differently, or other things are in the image, and "
                f"the standard deviation is widened. Worst at {worst}"
            )
        return tuple(found)

    def report(self) -> str:
        """The result as a few lines of text."""
        std = np.sqrt(np.diag(self.covariance))
        shift = ", ".join(f"{1e3 * v:+.2f}" for v in self.shift_m)
        turn = ", ".join(f"{v:+.2f}" for v in np.degrees(self.rotation_vector))
        what, share, of = "mesh", "measured amplitude lies on it", "speckle and range scatter"
        if self.moved == IMAGE:
            what, of = "simulated object", "the residuals alone"
            share = "simulated amplitude lies on the measured surface"
        lines = [
            f"The {what} is shifted by {1e3 * np.linalg.norm(self.shift_m):.2f} mm "
            f"(x, y, z: {shift} mm) and turned by {self.rotation_deg:.2f} deg "
            f"(about x, y, z: {turn} deg) to lie on the measured one.",
            f"{self.inlier_share:.0%} of the {share}, {1e3 * self.rms_m:.2f} mm rms from it.",
        ]
        if self.likeness is not None:
            lines[-1] += f" The images correlate by {self.likeness:.2f}."
        if self.overlap is not None:
            lines[-1] += f" Simulated there, the overlap is {self.overlap:.2f}."
        if self.residual_ratio is not None:
            lines.append(f"The residuals are {self.residual_ratio:.1f} times what noise explains.")
            of += " and the residuals"
        if self.moved == MESH and not self.converged:
            of += " and the motion between the iterations"
        if self.degenerate_directions:
            lines.append(
                "Unobservable in these images, and constrained to no motion: "
                + "; ".join(self.degenerate_directions)
                + "."
            )
        else:
            shift = ", ".join(f"{1e3 * v:.2g}" for v in std[3:])
            turn = ", ".join(f"{v:.2g}" for v in np.degrees(std[:3]))
            lines.append(f"One standard deviation from {of}: {shift} mm and {turn} deg (x, y, z).")
        end = "Converged" if self.converged else "NOT converged: still moving"
        lines.append(f"{end} after {self.iterations} iterations.")
        doubts = replace(self, converged=True).remarks()
        lines += [f"Doubtful: {doubt}." for doubt in doubts]
        return "\n".join(lines)


def check_rigid(field: str, transform: np.ndarray) -> None:
    """Raise `ModelError` unless a finite matrix, shape (4, 4), is a rotation and a shift."""
    rotation = transform[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if off > 1e-6 or np.linalg.det(rotation) < 0.0 or not (transform[3] == (0, 0, 0, 1)).all():
        got = np.array2string(transform, precision=3, separator=", ").replace("\n", "")
        checks.fail(field, "a rotation and a shift, with last row [0, 0, 0, 1]", got)


def warned(function: str, found: Alignment) -> Alignment:
    """Warn by every remark of a result that `function` is about to return."""
    for remark in found.remarks():
        warn(f"{function}: {remark}")
    return found

"""Synthetic measurements of objects whose pose is known, for `alignment_accuracy.py`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hand_poses import poses
from scipy.spatial.transform import Rotation

import clradar
from calibration.registration.rigid_motion import kabsch
from clradar.hand import JOINT_NAMES, hand_mesh

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)
SNR_DB = 20.0
MOST_SHIFT_M, MOST_TURN_DEG = 20e-3, 15.0
ALPHAS = (0.0, 0.15, 0.3, 0.45, 0.6)
SAMPLES_PER_MM2 = 6.0
RIGHT_M = 0.3
BENT_DEG = 15.0
FINGERS = ("index", "middle", "ring", "pinky")


def mesh(name: str) -> clradar.Scene:
    """Return an object by name, before it is moved: a hand, or a box, sphere or plate."""
    import trimesh

    if name in poses():
        return clradar.Scene.from_mesh(hand_mesh(poses()[name]))
    if name == "left":
        return clradar.Scene.from_mesh(hand_mesh("F", handedness="left"))
    if name in ("box", "tilted box"):
        shape = trimesh.creation.box(extents=(0.07, 0.05, 0.04))
        if name == "tilted box":  # its faces glint past the aperture
            shape.apply_transform(turn_about([12.0, 15.0, 10.0], np.zeros(3)))
    elif name == "sphere":
        shape = trimesh.creation.icosphere(subdivisions=5, radius=0.04)
    elif name == "plate":
        shape = trimesh.creation.box(extents=(0.09, 0.07, 0.002))
    else:
        raise ValueError(f"no object is called {name!r}")
    shape.apply_translation([0.0, 0.0, RIGHT_M])
    return clradar.Scene.from_mesh(shape)


def bent_otherwise(name: str, rng: np.random.Generator) -> tuple[clradar.Scene, np.ndarray]:
    """Return a hand with three fingers bent otherwise by 15 degrees, and the motion of its palm.

    The motion, shape (4, 4), starts at the palm of `mesh(name)`: boxes are centred, palms are not.
    """
    pose = poses()[name]
    bones = [f"{finger}-finger-phalanx-proximal" for finger in FINGERS]
    chosen = rng.choice(bones, 3, replace=False)
    by_rad = np.radians(BENT_DEG) * rng.choice([-1, 1])
    # Where a knuckle cannot bend further, the other way.
    if any(pose.joints[bone].flexion_rad + by_rad > np.radians(95.0) for bone in chosen):
        by_rad = -by_rad
    joints = {
        bone: replace(angles, flexion_rad=angles.flexion_rad + by_rad * (bone in chosen))
        for bone, angles in pose.joints.items()
    }
    before, after = hand_mesh(pose), hand_mesh(replace(pose, joints=joints))
    palm = [JOINT_NAMES.index(joint) for joint in ("wrist", *bones)]
    motion = kabsch(before.joints_m[palm], after.joints_m[palm], np.ones(len(palm)))
    return clradar.Scene.from_mesh(after), motion


def turn_about(rotation_deg: list[float] | np.ndarray, centre_m: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation_deg, degrees=True).as_matrix()
    matrix[:3, 3] = centre_m - matrix[:3, :3] @ centre_m
    return matrix


def middle_m(scene: clradar.Scene) -> np.ndarray:
    """Return the centre of the bounding box, shape (3,), metres: errors are given there."""
    return 0.5 * (scene.vertices_m.min(axis=0) + scene.vertices_m.max(axis=0))


def random_motion(scene: clradar.Scene, rng: np.random.Generator) -> np.ndarray:
    """Return a rigid motion: both axes uniform over the sphere, both sizes up to the most."""
    axis, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    size_deg, size_m = rng.uniform(0.0, (MOST_TURN_DEG, MOST_SHIFT_M))
    motion = turn_about(size_deg * axis, middle_m(scene))
    motion[:3, 3] += size_m * shift
    return motion


@dataclass(frozen=True, slots=True)
class Error:
    """How far a transform is from the truth, at the middle of the object."""

    position_mm: float
    rotation_deg: float


def error_of(found: np.ndarray, true: np.ndarray, at_m: np.ndarray) -> Error:
    """Return the error of `found`; `at_m` is the middle of the object before it is moved."""
    apart = (found - true)[:3, :3] @ at_m + (found - true)[:3, 3]
    turn = Rotation.from_matrix(found[:3, :3] @ true[:3, :3].T)
    return Error(1e3 * float(np.linalg.norm(apart)), float(np.degrees(turn.magnitude())))


def image(scene: clradar.Scene, seed: int, spacing_m: float, snr_db: float | None = SNR_DB,
          samples_per_mm2: float = SAMPLES_PER_MM2) -> clradar.Volume:  # fmt: skip
    """Return the simulated image of a scene, with noise, on the grid of the paper's experiment."""
    capture = clradar.simulate(
        scene, ARRAY, WAVEFORM, samples_per_mm2=samples_per_mm2, rays_per_sample=4, seed=seed
    )
    if snr_db is not None:
        capture = clradar.impair(capture, snr_db=snr_db, seed=seed)
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.24, 0.36), spacing_m)
    return clradar.backproject(capture, grid)

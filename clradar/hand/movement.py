"""A moving hand: its pose and place in every frame of a recording."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.hand.joints import JOINT_NAMES
from clradar.hand.known_poses import pose_by_name
from clradar.hand.mesh import DEFAULT_CENTER_M, HandMesh
from clradar.hand.pose import HandPose, interpolate_poses
from clradar.hand.pose_file import read_pose
from clradar.hand.shape import AVERAGE, HandShape
from clradar.hand.skeleton import posed_skeleton
from clradar.model import checks
from clradar.model.plausible import place
from clradar.model.record import Record

MAX_FRAMES = 10_000
RATE_HZ = 8.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HandMovement(Record):
    """Pose and place of a hand in every frame of a recording; `hand_movement` makes one.

    Parameters
    ----------
    poses : tuple of HandPose
        One per frame.
    transforms : array_like, shape (n_frames, 4, 4), float64, metres
        Rigid motion from the frame of the hand (`posed_skeleton`: the wrist is the origin; a left
        hand is its mirror image in x) to the antenna frame.
    handedness : "right" or "left"
    rate_hz : float, hertz
        Frames per second.

    Examples
    --------
    >>> import numpy as np
    >>> from clradar.hand import HandMovement, pose_by_name
    >>> still = HandMovement([pose_by_name("F")] * 2, np.tile(np.eye(4), (2, 1, 1)), rate_hz=10.0)
    >>> still.timestamps_us, still.joints_m(1)[0].tolist()
    ((0, 100000), [0.0, 0.0, 0.0])
    """

    poses: tuple[HandPose, ...]
    transforms: np.ndarray
    handedness: str = "right"
    rate_hz: float = RATE_HZ

    def __post_init__(self) -> None:
        self._set(poses=tuple(self.poses))
        self._set_array("transforms", np.float64, (len(self.poses), 4, 4))
        checks.one_of("HandMovement.handedness", self.handedness, ("right", "left"))
        self._set(rate_hz=checks.positive("HandMovement.rate_hz", self.rate_hz))

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def timestamps_us(self) -> tuple[int, ...]:
        """When the frames are, from 0 on, whole microseconds."""
        return tuple(round(1e6 * frame / self.rate_hz) for frame in range(len(self)))

    def joints_m(self, frame: int, shape: HandShape = AVERAGE) -> np.ndarray:
        """The joints of the hand of this package in a frame, (25, 3), antenna frame, metres."""
        joints_m = posed_skeleton(self.poses[frame], shape).joints_m * self._mirror
        rotation, shift_m = self.transforms[frame, :3, :3], self.transforms[frame, :3, 3]
        return joints_m @ rotation.T + shift_m

    def placed(self, frame: int, mesh: HandMesh) -> HandMesh:
        """Bring a mesh to the place that the hand has in a frame.

        Parameters
        ----------
        frame : int
        mesh : HandMesh
            Of `hand_mesh` or of a rig, in ``poses[frame]`` and of this handedness, upright as they
            are made, anywhere. Its wrist is the origin of the frame of the hand.
        """
        at_origin = mesh.moved(np.eye(3), -mesh.joints_m[JOINT_NAMES.index("wrist")])
        return at_origin.moved(self.transforms[frame, :3, :3], self.transforms[frame, :3, 3])

    @property
    def _mirror(self) -> np.ndarray:
        return np.array([-1.0 if self.handedness == "left" else 1.0, 1.0, 1.0])


def minimum_jerk(time: float) -> float:
    """Share of the way at a share of the time: from rest to rest with the least jerk.

    Flash and Hogan, "The coordination of arm movements: an experimentally confirmed mathematical
    model", Journal of Neuroscience 5(7), 1985: 10 t^3 - 15 t^4 + 6 t^5.

    Examples
    --------
    >>> from clradar.hand.movement import minimum_jerk
    >>> [minimum_jerk(time) for time in (0.0, 0.25, 0.5, 1.0)]
    [0.0, 0.103515625, 0.5, 1.0]
    """
    return time**3 * (10.0 - 15.0 * time + 6.0 * time**2)


def hand_movement(
    poses: Sequence[str | os.PathLike[str] | HandPose],
    n_frames: int,
    *,
    rate_hz: float = RATE_HZ,
    handedness: str = "right",
    shape: HandShape = AVERAGE,
    center_m: Any = DEFAULT_CENTER_M,
    shift_m: Any = (0.0, 0.0, 0.0),
    turn_rad: Any = (0.0, 0.0, 0.0),
) -> HandMovement:
    """Return a hand that goes from pose to pose, at rest in each, and moves as a whole meanwhile.

    Each frame is a still hand: what moves while a frame is recorded is not modelled.

    Parameters
    ----------
    poses : sequence of str, path-like or HandPose
        Names in `POSES`, pose files (.toml, .json) or poses, in their order, at equal steps of
        time. Between two of them the angles are interpolated (`interpolate_poses`) with the
        `minimum_jerk` profile of time. A single one stays.
    n_frames : int, 2 to 10000
        The first frame has the first pose, the last frame the last one.
    rate_hz : float, hertz
        Frames per second.
    handedness : {"right", "left"}
    shape : HandShape
        Of the hand whose box of joints is centred.
    center_m : array_like, shape (3,), metres
        Where the centre of the box around the joints of all frames is, before shift and turn. The
        wrist stays in its place while the pose changes.
    shift_m : array_like, shape (3,), metres
        How far the hand has moved in the last frame, with one `minimum_jerk` profile over all
        frames.
    turn_rad : array_like, shape (3,), radians
        Rotation vector (axis times angle) about `center_m` in the last frame, likewise.

    Returns
    -------
    HandMovement

    Examples
    --------
    A fist that opens, in ten frames; and the mesh of the first.

    >>> from clradar.hand import hand_mesh, hand_movement
    >>> movement = hand_movement(["S", "flat"], 10, shift_m=(0.0, 0.0, 0.02))
    >>> len(movement), movement.timestamps_us[:3]
    (10, (0, 125000, 250000))
    >>> mesh = movement.placed(0, hand_mesh(movement.poses[0], edge_length_m=4e-3))
    >>> bool(abs(mesh.joints_m - movement.joints_m(0)).max() < 1e-12)
    True
    """
    if isinstance(poses, str | os.PathLike | HandPose):
        poses = [poses]
    keys = [pose_of(pose) for pose in poses]
    if not keys:
        checks.fail("poses", "at least one", "none")
    n_frames = checks.whole("n_frames", n_frames, 2, MAX_FRAMES)
    centre_m = place("center_m", center_m)
    shift_m = checks.read_only("shift_m", shift_m, np.float64, (3,))
    turn_rad = checks.read_only("turn_rad", turn_rad, np.float64, (3,))
    checks.instance("shape", shape, HandShape)
    over_time = tuple(_between(keys, i / (n_frames - 1)) for i in range(n_frames))
    still = HandMovement(over_time, np.tile(np.eye(4), (n_frames, 1, 1)), handedness, rate_hz)
    joints_m = np.concatenate([still.joints_m(i, shape) for i in range(n_frames)])
    to_centre_m = -0.5 * (joints_m.min(axis=0) + joints_m.max(axis=0))
    transforms = np.tile(np.eye(4), (n_frames, 1, 1))
    for i, transform in enumerate(transforms):
        share = minimum_jerk(i / (n_frames - 1))
        transform[:3, :3] = _rotation(share * turn_rad)
        transform[:3, 3] = transform[:3, :3] @ to_centre_m + centre_m + share * shift_m
    return HandMovement(over_time, transforms, handedness, rate_hz)


def pose_of(pose: str | os.PathLike[str] | HandPose) -> HandPose:
    """Return a pose that is given by its name, by a pose file, or as it is."""
    if isinstance(pose, HandPose):
        return pose
    if not isinstance(pose, str | os.PathLike):
        checks.fail("poses", "names, pose files or poses", repr(pose))
    return read_pose(pose) if Path(pose).suffix else pose_by_name(os.fspath(pose))


def _between(keys: Sequence[HandPose], time: float) -> HandPose:
    """The pose at a share of the time, 0 to 1."""
    steps = time * (len(keys) - 1)
    begin = min(int(steps), len(keys) - 2)
    if len(keys) == 1 or keys[begin] == keys[begin + 1]:
        return keys[max(begin, 0)]
    return interpolate_poses(keys[begin], keys[begin + 1], minimum_jerk(steps - begin))


def _rotation(turn_rad: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(turn_rad).as_matrix()

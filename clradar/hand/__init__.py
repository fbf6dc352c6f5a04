"""A parametric hand as a radar target: poses, shapes, forward kinematics, and a closed surface.

The surface is an implicit one, round cones along the bones united by smooth minima, triangulated by
marching cubes; see ``docs/poses.md``.
"""

from clradar.hand.flesh import PART_NAMES
from clradar.hand.joints import ANGLES, JOINT_NAMES, LIMITS_DEG
from clradar.hand.mesh import HandMesh, hand_mesh
from clradar.hand.pose import HandPose, JointAngles, interpolate_poses
from clradar.hand.pose_file import DIGITS, LETTERS, POSES, pose_by_name, read_pose, write_pose
from clradar.hand.sampler import pose_around, random_pose
from clradar.hand.shape import ADULT_RANGES, HandShape, random_shape
from clradar.hand.skeleton import Skeleton, posed_skeleton

__all__ = [
    "ADULT_RANGES",
    "ANGLES",
    "DIGITS",
    "JOINT_NAMES",
    "LETTERS",
    "LIMITS_DEG",
    "PART_NAMES",
    "POSES",
    "HandMesh",
    "HandPose",
    "HandShape",
    "JointAngles",
    "Skeleton",
    "hand_mesh",
    "interpolate_poses",
    "pose_around",
    "pose_by_name",
    "posed_skeleton",
    "random_pose",
    "random_shape",
    "read_pose",
    "write_pose",
]


def __dir__() -> list[str]:
    return sorted(__all__)

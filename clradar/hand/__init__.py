"""A parametric hand: skeleton, poses, and a closed surface as a target in front of the radar."""

from clradar.hand.mesh import HandMesh, hand_joints, hand_mesh
from clradar.hand.pose import POSES, FingerPose, HandPose, ThumbPose, pose_by_name
from clradar.hand.skeleton import JOINT_NAMES

__all__ = [
    "JOINT_NAMES",
    "POSES",
    "FingerPose",
    "HandMesh",
    "HandPose",
    "ThumbPose",
    "hand_joints",
    "hand_mesh",
    "pose_by_name",
]

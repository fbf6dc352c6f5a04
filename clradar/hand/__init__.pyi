from .flesh import PART_NAMES as PART_NAMES
from .joints import ANGLES as ANGLES, JOINT_NAMES as JOINT_NAMES, LIMITS_DEG as LIMITS_DEG
from .mesh import HandMesh as HandMesh, hand_mesh as hand_mesh
from .pose import (
    HandPose as HandPose,
    JointAngles as JointAngles,
    interpolate_poses as interpolate_poses,
)
from .pose_file import (
    DIGITS as DIGITS,
    LETTERS as LETTERS,
    POSES as POSES,
    pose_by_name as pose_by_name,
    read_pose as read_pose,
    write_pose as write_pose,
)
from .sampler import pose_around as pose_around, random_pose as random_pose
from .shape import (
    ADULT_RANGES as ADULT_RANGES,
    HandShape as HandShape,
    random_shape as random_shape,
)
from .skeleton import Skeleton as Skeleton, posed_skeleton as posed_skeleton

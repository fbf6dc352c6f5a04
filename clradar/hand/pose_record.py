"""The record of a pose file: angles in degrees by joint; ``docs/poses.md`` has the format."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from clradar.files.records import FileRecord, Number, Text, made, mistake
from clradar.files.toml_file import nearest
from clradar.hand.joints import JOINT_NAMES
from clradar.hand.pose import HandPose, JointAngles


def _joint(name: Any) -> Any:
    if name not in JOINT_NAMES:
        expected = "one of the 25 joints of WebXR Hand Input, such as 'index-finger-tip'"
        raise mistake(expected, f"'{name}'{nearest(str(name), JOINT_NAMES)}")
    return name


JointName = Annotated[str, BeforeValidator(_joint)]


class JointTable(FileRecord):
    """The angles of a joint."""

    flexion_deg: Number = 0.0
    abduction_deg: Number = 0.0
    twist_deg: Number = 0.0


class PoseFile(FileRecord):
    """What a pose file says."""

    name: Text
    description: str = ""
    source: str = ""
    joints: dict[JointName, JointTable] = Field(
        description="a table joints, with the angles of each joint"
    )

    @model_validator(mode="after")
    def _is_a_pose(self) -> PoseFile:
        made(self.pose)
        return self

    def pose(self) -> HandPose:
        angles = {
            name: JointAngles.from_degrees(*dict(own).values()) for name, own in self.joints.items()
        }
        return HandPose(self.name, angles, self.description, self.source)

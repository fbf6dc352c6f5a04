"""The record of a mapping file: the node of each joint of a rig."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from clradar.files.records import FileRecord, checked
from clradar.hand.pose_record import JointName

Node = Annotated[
    str | int,
    checked("the name or number of a node", lambda v: type(v) in (str, int), lambda v: v),
]


class MappingFile(FileRecord):
    """What a mapping file says: WebXR name = name or number of a node."""

    joints: dict[JointName, Node] = Field(description="a table [joints]: WebXR name = node")

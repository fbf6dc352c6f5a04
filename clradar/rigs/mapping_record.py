"""Mapping files: the node of each joint of a rig; ``docs/rigs.md`` has the format."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from clradar.errors import RigError
from clradar.files.records import FileRecord, checked, read_record, record_of
from clradar.hand.pose_record import JointName

Node = Annotated[
    str | int,
    checked("the name or number of a node", lambda v: type(v) in (str, int)),
]


class MappingFile(FileRecord):
    """What a mapping file says: WebXR name = name or number of a node."""

    joints: dict[JointName, Node] = Field(description="a table [joints]: WebXR name = node")


def nodes_of(
    mapping: str | os.PathLike[str] | Mapping[str, str | int], rig: Path
) -> dict[str, str | int]:
    """Return the node of each joint of a mapping or of its file."""
    if isinstance(mapping, Mapping):
        return record_of({"joints": dict(mapping)}, MappingFile, rig, error=RigError).joints
    expected = "a TOML file with a table [joints]: WebXR name = node"
    return read_record(Path(mapping), MappingFile, expected, error=RigError).joints

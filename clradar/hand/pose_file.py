"""Pose files: TOML or JSON, angles in degrees by joint; format in ``docs/poses.md``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import MeasurementError, ModelError, OutputError, quoted
from clradar.files.atomic import write_file
from clradar.files.failures import fail, read_bytes, reading, shown
from clradar.files.json_text import indented, parse_json
from clradar.files.limits import MAX_TOML_BYTES
from clradar.files.toml_file import parse_toml, toml_document, unknown_key
from clradar.hand.joints import ANGLES
from clradar.hand.pose import HandPose, JointAngles, check_angles

SUFFIXES = (".toml", ".json")

_EXPECTED = "a pose (a TOML or JSON file, see docs/poses.md)"
_KEYS = ("name", "description", "source", "joints")


def read_pose(path: str | os.PathLike[str]) -> HandPose:
    """Return the pose of a file whose name ends in .toml or .json; docs/poses.md has the format.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.hand import read_pose
    >>> text = 'name = "hook"\\n[joints.index-finger-phalanx-intermediate]\\nflexion_deg = 80'
    >>> _ = Path("hook.toml").write_text(text)
    >>> read_pose("hook.toml").angles("index-finger-phalanx-intermediate").degrees()
    (80.0, 0.0, 0.0)
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        fail(path, f"a name that ends in {' or '.join(SUFFIXES)}", f"'{path.suffix}'")
    return parse_pose(read_bytes(path, _EXPECTED, MAX_TOML_BYTES), path)


def parse_pose(content: bytes, path: Path) -> HandPose:
    """Return the pose of a file's content, JSON or TOML by the ending of its name."""
    with reading(path, _EXPECTED):
        text = content.decode("utf-8-sig")
        parsed = parse_json(text) if path.suffix.lower() == ".json" else parse_toml(text)
    return pose_of_table(parsed, path)


def write_pose(path: str | os.PathLike[str], pose: HandPose, *, force: bool = False) -> None:
    """Write a pose to a .toml or .json file, whole or not at all.

    Reading it gives the pose again; an angle that is not a decimal number of degrees may come back
    changed by its last bit.

    Parameters
    ----------
    path : path-like
        Target. Its folder has to exist.
    pose : HandPose
    force : bool
        Replace an existing file.

    Examples
    --------
    >>> from clradar.hand import pose_by_name, read_pose, write_pose
    >>> write_pose("letter.json", pose_by_name("W"))
    >>> read_pose("letter.json") == pose_by_name("W")
    True
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise OutputError(
            f"{shown(target)}: expected a name that ends in {' or '.join(SUFFIXES)}, "
            f"got '{target.suffix}'"
        )
    text = (indented if suffix == ".json" else toml_document)(pose_table(pose))
    write_file(target, text.encode("utf-8"), force=force)


def pose_of_table(parsed: Any, path: Path) -> HandPose:
    """Return the pose of a parsed file; `path` is what errors name."""
    top = _table(path, "", parsed, _KEYS)
    texts = {key: top.get(key, "") for key in _KEYS[:3]}
    for key, text in texts.items():
        if not isinstance(text, str) or (key == "name" and not text.strip()):
            got = "none" if key not in top else quoted(repr(text))
            fail(path, f"{key} to be a string that is not empty", got)
    if "joints" not in top:
        fail(path, "a table joints, with the angles of each joint", "none")
    joints = {}
    for joint, table in _table(path, "joints", top["joints"]).items():
        place = f"joints.{quoted(joint)}"
        given = _table(path, place, table, [f"{name}_deg" for name in ANGLES])
        try:
            joints[joint] = JointAngles.from_degrees(**given)
            check_angles(joint, joints[joint])
        except ModelError as error:
            place = "" if str(error).startswith("joint") else f"joint {quoted(joint)}: "
            raise MeasurementError(f"{shown(path)}: {place}{error}") from error
    return HandPose(texts["name"], joints, texts["description"], texts["source"])


def _table(path: Path, place: str, value: Any, keys: Sequence[str] = ()) -> dict[str, Any]:
    if not isinstance(value, dict):
        fail(path, f"{place or 'the pose'} to be a table", quoted(repr(value)))
    for key in value:
        if keys and key not in keys:
            at = f"{place}.{quoted(key)}".lstrip(".")
            raise MeasurementError(f"{shown(path)}: {at}: {unknown_key(key, keys)}")
    return value


def _decimal_deg(angle_rad: float) -> float:
    """Return the shortest decimal number of degrees that is this angle, else the nearest one."""
    angle_deg = float(np.rad2deg(angle_rad))
    for digits in range(17):
        rounded = round(angle_deg, digits)
        if float(np.deg2rad(rounded)) == angle_rad:
            return rounded
    return angle_deg


def _angles(angles: JointAngles) -> dict[str, float]:
    pairs = ((f"{name}_deg", getattr(angles, f"{name}_rad")) for name in ANGLES)
    return {key: _decimal_deg(value) for key, value in pairs if value != 0.0}


def pose_table(pose: HandPose) -> dict[str, Any]:
    """Return what a pose file holds, in types that JSON has."""
    record: dict[str, Any] = {"name": pose.name}
    record |= {k: v for k in ("description", "source") if (v := getattr(pose, k))}
    record["joints"] = {joint: _angles(angles) for joint, angles in pose.joints.items()}
    return record

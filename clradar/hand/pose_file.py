"""Poses by name and from files: TOML or JSON, angles in degrees; format in ``docs/poses.md``."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import astuple
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from clradar.errors import ClradarError, MeasurementError, OutputError
from clradar.files.atomic import write_file
from clradar.files.failures import fail
from clradar.files.json_file import indented
from clradar.files.toml_file import nearest, parse_toml, toml_document
from clradar.hand.joints import ANGLES
from clradar.hand.pose import HandPose, JointAngles
from clradar.model import checks

SUFFIXES = (".toml", ".json")

LETTERS: tuple[str, ...] = tuple("ABCDEFGHIKLMNOPQRSTUVWXY")
"""The static letters of the American manual alphabet: all but J and Z, which are movements."""

DIGITS: tuple[str, ...] = tuple("0123456789")


class _PackagedPoses(Mapping[str, HandPose]):
    """Poses of ``poses.toml``, which is read at the first use of one."""

    _NAMES = ("flat", *LETTERS, *DIGITS)

    def __getitem__(self, name: str) -> HandPose:
        return _packaged(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._NAMES)

    def __len__(self) -> int:
        return len(self._NAMES)


@cache
def _tables() -> dict[str, Any]:
    return parse_toml(resources.files("clradar.hand").joinpath("poses.toml").read_text("utf-8"))


@cache
def _packaged(name: str) -> HandPose:
    return pose_of_table({"name": name, **_tables()[name]}, Path("poses.toml"))


POSES: Mapping[str, HandPose] = _PackagedPoses()
"""Poses by name: `flat` (open hand), letters of the American manual alphabet, digits."""


def pose_by_name(name: str) -> HandPose:
    """Return a pose of `POSES`; in upper or lower case.

    Examples
    --------
    >>> clradar.hand.pose_by_name("f").name
    'F'
    """
    wanted = checks.text("pose", name).strip().casefold()
    for known in POSES:
        if known.casefold() == wanted:
            return POSES[known]
    got = f"{name!r}{nearest(name, tuple(POSES))}"
    checks.fail("pose", "one of " + ", ".join(repr(known) for known in POSES), got)


def pose_of(pose: str | os.PathLike[str] | HandPose) -> HandPose:
    """Return a pose that is given by its name, by a pose file, or as it is."""
    if isinstance(pose, HandPose):
        return pose
    if not isinstance(pose, str | os.PathLike):
        checks.fail("poses", "names, pose files or poses", repr(pose))
    return read_pose(pose) if Path(pose).suffix else pose_by_name(os.fspath(pose))


def read_pose(path: str | os.PathLike[str]) -> HandPose:
    """Return the pose of a .toml or .json file; docs/poses.md has the format.

    Examples
    --------
    >>> hook = clradar.hand.read_pose("hook.toml")
    >>> hook.angles("index-finger-phalanx-intermediate").degrees()
    (80.0, 0.0, 0.0)
    """
    from clradar.files.records import read_record
    from clradar.hand.pose_record import PoseFile

    _check_suffix(Path(path), MeasurementError)
    expected = "a pose (a TOML or JSON file, see docs/poses.md)"
    return read_record(Path(path), PoseFile, expected).pose()


def _check_suffix(path: Path, error: type[ClradarError]) -> None:
    if path.suffix.lower() not in SUFFIXES:
        wanted = f"a name that ends in {' or '.join(SUFFIXES)}"
        fail(path, wanted, f"'{path.suffix}'", error=error)


def pose_of_table(parsed: Any, path: Path) -> HandPose:
    """Return the pose of a parsed file; `path` is what errors name."""
    from clradar.files.records import record_of
    from clradar.hand.pose_record import PoseFile

    return record_of(parsed, PoseFile, path).pose()


def write_pose(path: str | os.PathLike[str], pose: HandPose, *, force: bool = False) -> None:
    """Write a pose to a .toml or .json file, whole or not at all; `force` replaces one.

    Angles that are no decimal number of degrees may be read back with another last bit.

    Examples
    --------
    >>> clradar.hand.write_pose("letter.json", clradar.hand.POSES["W"])
    >>> clradar.hand.read_pose("letter.json") == clradar.hand.POSES["W"]
    True
    """
    target = Path(path)
    _check_suffix(target, OutputError)
    checks.instance("write_pose: pose", pose, HandPose)
    text = (indented if target.suffix.lower() == ".json" else toml_document)(pose_table(pose))
    write_file(target, text.encode("utf-8"), force=force)


def pose_table(pose: HandPose) -> dict[str, Any]:
    """Return what a pose file holds, in types that JSON has."""
    record: dict[str, Any] = {"name": pose.name}
    record |= {k: v for k in ("description", "source") if (v := getattr(pose, k))}
    record["joints"] = {joint: _angles(angles) for joint, angles in pose.joints.items()}
    return record


def _angles(angles: JointAngles) -> dict[str, float]:
    pairs = zip(ANGLES, astuple(angles), strict=True)
    return {f"{name}_deg": _decimal_deg(rad) for name, rad in pairs if rad != 0.0}


def _decimal_deg(angle_rad: float) -> float:
    """Return the shortest decimal number of degrees that is this angle, else the nearest one."""
    angle_deg = math.degrees(angle_rad)
    tried = (round(angle_deg, digits) for digits in range(17))
    return next((deg for deg in tried if math.radians(deg) == angle_rad), angle_deg)

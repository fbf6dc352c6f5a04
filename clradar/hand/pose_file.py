"""Poses as small TOML or JSON files."""

from __future__ import annotations

import json
import os
import secrets
import stat
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from clradar.errors import MeasurementError, ModelError, OutputError
from clradar.hand.joints import ANGLES
from clradar.hand.pose import HandPose, JointAngles, check_angles

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SUFFIXES = (".toml", ".json")
LIMIT_BYTES = 2**18

_EXPECTED = "a pose (a TOML or JSON file, see docs/poses.md)"
_KEYS = ("name", "description", "source", "joints")
# A key of thousands of dotted parts keeps the parser of TOML busy for minutes.
_MAX_LINE = 2**12


def read_pose(path: str | os.PathLike[str]) -> HandPose:
    """Return the pose of a file whose name ends in .toml or .json; docs/poses.md has the format.

    Raises
    ------
    MeasurementError
        Missing, neither TOML nor JSON, an unknown joint or key, a value of the wrong type, an angle
        beyond its limit. The message names the file, the joint, what was expected, what was found.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        _fail(path, f"a name that ends in {' or '.join(SUFFIXES)}", f"'{path.suffix}'")
    return parse_pose(_content(path), path)


def parse_pose(content: bytes, path: Path) -> HandPose:
    """Return the pose of a file's content; the name says which of the two it is."""
    try:
        text = content.decode("utf-8-sig")
        if path.suffix.lower() == ".json":
            parsed = json.loads(text, object_pairs_hook=_without_repetition)
        else:
            if max((len(line) for line in text.splitlines()), default=0) > _MAX_LINE:
                _fail(path, f"lines of at most {_MAX_LINE} characters", "a longer one")
            parsed = tomllib.loads(text)
    except MeasurementError:
        raise
    except (ValueError, RecursionError) as error:  # both readers' errors are ValueErrors
        raise MeasurementError(f"{_shown(path)}: expected {_EXPECTED}, got {error}") from error
    return _pose(path, parsed)


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

    Raises
    ------
    OutputError
        The file exists, its folder does not, or it cannot be written.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise OutputError(
            f"{_shown(target)}: expected a name that ends in {' or '.join(SUFFIXES)}, "
            f"got '{target.suffix}'"
        )
    content = (_json(pose) if suffix == ".json" else _toml(pose)).encode("utf-8")
    temporary = target.with_name(f".clradar-{secrets.token_hex(6)}.tmp")
    try:
        if os.path.lexists(target) and not force:
            raise OutputError(f"{_shown(target)}: exists already; not overwritten without force")
        with temporary.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, target)
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{_shown(target)}: cannot be written: {reason}") from error
    finally:
        with suppress(OSError, ValueError):
            temporary.unlink()


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {max(keys, key=keys.count)!r} twice in one object")
    return table


def _shown(path: Path) -> str:
    return str(path).encode("utf-8", "backslashreplace").decode("utf-8")


def _fail(path: Path, expected: str, got: str) -> NoReturn:
    raise MeasurementError(f"{_shown(path)}: expected {expected}, got {got}")


def _content(path: Path) -> bytes:
    try:
        status = os.stat(path)
        # Opening a pipe or a terminal would wait for ever.
        if not stat.S_ISREG(status.st_mode):
            _fail(path, _EXPECTED, "something that is no regular file")
        if status.st_size > LIMIT_BYTES:
            _fail(path, f"a pose of at most {LIMIT_BYTES} bytes", f"{status.st_size} bytes")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MeasurementError(f"{_shown(path)}: expected {_EXPECTED}, got {reason}") from error


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _table(
    path: Path, place: str, value: Any, keys: tuple[str, ...] | None = None
) -> dict[str, Any]:
    if not isinstance(value, dict):
        _fail(path, f"{place} to be a table", _brief(value))
    for key in value:
        if keys is not None and key not in keys:
            raise MeasurementError(
                f"{_shown(path)}: {place}: expected one of {', '.join(keys)}, got {_brief(key)}"
            )
    return value


def _pose(path: Path, parsed: Any) -> HandPose:
    top = _table(path, "the pose", parsed, _KEYS)
    texts = {key: top.get(key, "") for key in _KEYS[:3]}
    for key, text in texts.items():
        if not isinstance(text, str):
            _fail(path, f"{key} to be a string", _brief(text))
    if not texts["name"].strip():
        _fail(path, "a name", "none" if "name" not in top else repr(texts["name"]))
    if "joints" not in top:
        _fail(path, "a table joints, with the angles of each joint", "none")
    angle_keys = tuple(f"{name}_deg" for name in ANGLES)
    joints = {}
    for joint, table in _table(path, "joints", top["joints"]).items():
        given = _table(path, f"joints.{joint}", table, angle_keys)
        try:
            angles = JointAngles.from_degrees(**given)
            check_angles(joint, angles)
        except ModelError as error:
            place = "" if str(error).startswith("joint") else f"joint {joint}: "
            raise MeasurementError(f"{_shown(path)}: {place}{error}") from error
        joints[joint] = angles
    return HandPose(texts["name"], joints, texts["description"], texts["source"])


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


def _record(pose: HandPose) -> dict[str, Any]:
    record: dict[str, Any] = {"name": pose.name}
    record |= {k: v for k in ("description", "source") if (v := getattr(pose, k))}
    record["joints"] = {joint: _angles(angles) for joint, angles in pose.joints.items()}
    return record


def _json(pose: HandPose) -> str:
    return json.dumps(_record(pose), indent=2, ensure_ascii=False) + "\n"


def _toml(pose: HandPose) -> str:
    record = _record(pose)
    joints = record.pop("joints")
    # A string of JSON is one of TOML but for DEL, which only TOML wants escaped.
    lines = [
        f"{key} = {json.dumps(text, ensure_ascii=False)}".replace("\x7f", "\\u007f")
        for key, text in record.items()
    ]
    lines += [""] if joints else ["", "[joints]"]
    for joint, angles in joints.items():
        lines += [f"[joints.{joint}]", *(f"{k} = {v!r}" for k, v in angles.items()), ""]
    return "\n".join(lines).rstrip("\n") + "\n"

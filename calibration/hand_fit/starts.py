"""Where the fit of a hand starts: poses by name, of files, or of earlier fits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from calibration.hand_fit.result import HandFit
from calibration.registration.alignment import check_rigid
from clradar.errors import ClradarError, MeasurementError, ModelError, quoted
from clradar.files.failures import fail, shown
from clradar.files.json_file import read_json_object
from clradar.files.toml_file import nearest
from clradar.hand import LETTERS, POSES, HandPose, HandShape, pose_by_name, read_pose
from clradar.hand.pose_file import SUFFIXES, pose_of_table
from clradar.model import checks

FIT_FILE = "fit.json"
"""In the folder of a fit; `HandFit.to_dict` with what made it."""

ALL = "all"  # all letters of the alphabet
EARLIER_FIT = "an earlier fit"


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a fit starts; None: the shape and the side that the fit is given.

    `transform`, (4, 4), metres, is as `HandFit.transform`; None: the place is searched for.
    """

    pose: HandPose  # the mean of the prior
    shape: HandShape | None = None
    handedness: str | None = None  # "right" or "left"
    transform: np.ndarray | None = None
    source: str = ""  # an earlier fit that the pose was taken from

    @property
    def name(self) -> str:
        """What results call the start: the earlier fit, or the name of the pose."""
        return self.source or self.pose.name


PoseLike: TypeAlias = "str | Path | HandPose | HandFit | Start"


def starts_of(pose: PoseLike | Iterable[PoseLike]) -> tuple[Start, ...]:
    """Return the starts that the argument `pose` of `fit_hand` names, of one or several.

    Each is a name in `clradar.hand.POSES`, "all" for all letters, a pose file (.toml, .json), a
    pose, an earlier fit, its folder, or its file fit.json. A string that is a name is one, whatever
    files there are. No such pose, none at all, or another type is a `ModelError`.
    """
    if isinstance(pose, str | Path | HandPose | HandFit | Start):
        return _starts(pose)
    if not isinstance(pose, Iterable):
        checks.fail("pose", "a name, a pose, an earlier fit, or several", type(pose).__name__)
    found = tuple(start for one in pose for start in _starts(one))
    if not found:
        checks.fail("pose", "at least one", "none")
    return found


def _starts(pose: Any) -> tuple[Start, ...]:
    if isinstance(pose, Start):
        return (pose,)
    if isinstance(pose, HandPose):
        return (Start(pose),)
    if isinstance(pose, HandFit):
        return (Start(pose.pose, pose.shape, pose.handedness, pose.transform, source=EARLIER_FIT),)
    if isinstance(pose, str) and pose.strip().casefold() == ALL:
        return tuple(Start(POSES[letter]) for letter in LETTERS)
    if isinstance(pose, str) and start_file(pose) is None:
        return (Start(_named(pose)),)
    if isinstance(pose, str | Path):
        return (read_start(Path(pose)),)
    checks.fail("pose", "a name, a pose file, a HandPose or a HandFit", type(pose).__name__)


def _named(name: str) -> HandPose:
    try:
        return pose_by_name(name)
    except ModelError:
        known = ", ".join(repr(known) for known in POSES)
        others = f"'{ALL}', a pose file ({', '.join(SUFFIXES)}), or the folder of an earlier fit"
        meant = nearest(name, (*POSES, ALL))
        checks.fail("pose", f"one of {known}, {others}", f"{name!r}{meant}")


def start_file(text: str) -> Path | None:
    """The file that a string names, in the folder of a fit its fit.json; None if it names none: a
    pose of that name comes first."""
    if text.strip().casefold() in {"", ALL, *(name.casefold() for name in POSES)}:
        return None
    path = Path(text)
    if path.is_dir():
        return path / FIT_FILE
    return path if path.suffix.lower() in SUFFIXES else None


def read_start(path: Path) -> Start:
    """Return the start in a pose file, a fit.json, or the folder of a fit.

    Raises
    ------
    MeasurementError
        The file is missing or neither; the message names it.
    """
    if path.is_dir():
        if not (path / FIT_FILE).is_file():
            fail(path, f"the folder of a fit, which holds {FIT_FILE}", "none")
        path = path / FIT_FILE
    if path.suffix.lower() != ".json":
        return Start(read_pose(path))
    record = read_json_object(path)
    return _start_of_fit(record, path) if "transform" in record else Start(read_pose(path))


def _start_of_fit(record: dict[str, Any], path: Path) -> Start:
    # The shape of a rig is its own.
    for key, kind in (("pose", dict), ("shape", dict | None), ("handedness", str)):
        if key not in record or not isinstance(record[key], kind):
            got = "none" if key not in record else quoted(repr(record[key]))
            fail(path, f"'{key}' of a fitted hand", got)
    pose = pose_of_table(record["pose"], path)
    try:
        shape = None if record["shape"] is None else HandShape(**record["shape"])
        handedness = checks.one_of("handedness", record["handedness"], ("right", "left"))
        transform = checks.read_only("transform", record["transform"], np.float64, (4, 4))
        check_rigid("transform", transform)
    except (ModelError, TypeError) as error:
        said = str(error) if isinstance(error, ClradarError) else f"shape: {error}"
        raise MeasurementError(f"{shown(path)}: {said}") from error
    fit = path.resolve().parent if path.name == FIT_FILE else path
    return Start(pose, shape, handedness, transform, source=fit.name)

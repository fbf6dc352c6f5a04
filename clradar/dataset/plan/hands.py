"""The tables [poses], [hands], [placement], [movement] and alpha of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, ValidationInfo, model_validator

from clradar.dataset.plan.values import (
    Draw,
    Value,
    choice,
    draws,
    fixed,
    floats,
    number,
    tried,
    whole,
)
from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import clean
from clradar.files.hashing import sha256_of
from clradar.files.records import FileRecord, mistake
from clradar.files.toml_file import choice_text, toml_brief
from clradar.hand import (
    ANGLES,
    DIGITS,
    JOINT_NAMES,
    LETTERS,
    PART_NAMES,
    POSES,
    HandPose,
    HandShape,
    JointAngles,
    pose_by_name,
    read_pose,
)
from clradar.hand.sampler import MOST_SPREAD_DEG, SPREAD_DEG
from clradar.hand.shape import AVERAGE, BREADTH_LIMITS_M, FACTOR_LIMITS, LENGTH_LIMITS_M
from clradar.motion.timing import ORDERS, RATE_HZ, STEP_S

POSE_SETS = {"letters": LETTERS, "digits": DIGITS, "all": (*LETTERS, *DIGITS)}
"""Names of sets of poses."""

EDGE_MM = 2.0
"""About 29 000 faces; see docs/datasets.md for what other lengths cost and err."""

NEAREST_MM, FARTHEST_MM = 100.0, 3000.0
"""Limits of the centre of a hand along z."""

SIDE_MM = 1000.0
MOST_FRAMES = 10_000

SHAPE_COLUMNS = (
    "length_m",
    "breadth_m",
    *(f"finger_lengths.{digit}" for digit in ("thumb", "index", "middle", "ring", "pinky")),
    "girth",
)
"""Names of the numbers of `shape_row`."""


def pose_record(pose: HandPose) -> dict[str, Any]:
    """Return name and angles, without joints whose angles are all 0."""
    joints = {
        joint: [getattr(angles, f"{name}_rad") for name in ANGLES]
        for joint, angles in pose.joints.items()
    }
    return {"name": pose.name, "joints_rad": joints}


def pose_of(record: Mapping[str, Any]) -> HandPose:
    joints = {joint: JointAngles(*angles) for joint, angles in record["joints_rad"].items()}
    return HandPose(record["name"], joints)


def angles_rad(pose: HandPose) -> np.ndarray:
    """Return the angles of all joints, shape (25, 3), radians: `JOINT_NAMES` by `ANGLES`."""
    joints = (pose.angles(name) for name in JOINT_NAMES)
    return np.array([[getattr(own, f"{name}_rad") for name in ANGLES] for own in joints])


def shape_record(shape: HandShape) -> dict[str, Any]:
    return {**asdict(shape), "finger_lengths": list(shape.finger_lengths)}


def shape_row(shape: HandShape | None) -> list[float]:
    """Return a shape as numbers, in the order of `SHAPE_COLUMNS`; NaN if there is none."""
    if shape is None:
        return [float("nan")] * len(SHAPE_COLUMNS)
    return [shape.length_m, shape.breadth_m, *shape.finger_lengths, shape.girth]


Side = Annotated[Draw, draws(-SIDE_MM, SIDE_MM)]
Turn = Annotated[Draw, draws(-360.0, 360.0)]
Share = Annotated[Draw, draws(0.0, 1.0, ("uniform", "choice"))]


def texts(value: Any, what: str) -> tuple[str, ...]:
    """A list of different texts."""
    if not isinstance(value, list) or not all(isinstance(v, str) and v for v in value):
        raise mistake(f"a list of {what}", value)
    if twice := sorted({v for v in value if value.count(v) > 1}):
        raise mistake(f"every one of the {what} once", f"{', '.join(twice)} more often")
    return tuple(value)


def folder_of(info: ValidationInfo) -> Path:
    """What names of files in a plan are relative to."""
    return Path() if info.context is None else info.context["folder"]


def _named(value: Any) -> tuple[HandPose, ...]:
    if isinstance(value, str):
        if value not in POSE_SETS:
            raise mistake(choice_text(value, (*POSE_SETS, "a list of names")), toml_brief(value))
        value = list(POSE_SETS[value])
    for name in texts(value, "names of poses"):
        if not any(known.casefold() == name.casefold() for known in POSES):
            raise mistake(choice_text(name, tuple(POSES)), toml_brief(name))
    return tuple(pose_by_name(name) for name in value)


def _of_file(value: Any, info: ValidationInfo) -> HandPose:
    if not isinstance(value, str) or not value:
        raise mistake("the name of a pose file", toml_brief(value))
    pose: HandPose = tried(read_pose, folder_of(info) / value)
    return pose


def _of_record(value: Any) -> HandPose:
    try:
        return pose_of(value)
    except (ClradarError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise mistake("a name and joints_rad", clean(repr(error))) from error


_NAMES = {"anyOf": [{"enum": list(POSE_SETS)}, {"type": "array", "items": {"type": "string"}}]}


class Poses(FileRecord):
    """The table [poses]: a pose of the list; one between two of them; one drawn around a pose of
    the list; or a random one within the limits of joints ("sampler").

    `poses` are those of `names`, of `files`, and of manifests (`resolved`). Sample i has pose i
    modulo their number, or a random one. Of "interpolation" `share` 0 is the first of the two
    poses, 1 the second; `spread_deg` is the standard deviation of "around".
    """

    kind: Annotated[str, choice("list", "interpolation", "around", "sampler")] = "list"
    names: Annotated[tuple[HandPose, ...], Value(_named, _NAMES)] = ()
    files: tuple[Annotated[HandPose, Value(_of_file, {"type": "string"}, True)], ...] = ()
    resolved: tuple[Annotated[HandPose, Value(_of_record, {"type": "object"})], ...] = ()
    order: Annotated[str, choice("cycle", "random")] = "cycle"
    share: Share = Draw("uniform", (0.0, 1.0))
    spread_deg: Annotated[float, number(0.0, MOST_SPREAD_DEG)] = SPREAD_DEG

    @property
    def poses(self) -> tuple[HandPose, ...]:
        return (*self.names, *self.files, *self.resolved)

    @model_validator(mode="after")
    def _check(self) -> Poses:
        given, found = self.model_fields_set, self.poses
        if "share" in given and self.kind != "interpolation":
            got = toml_brief(self.share.to_plain())
            raise mistake('no share unless kind = "interpolation"', got, key="share")
        if "spread_deg" in given and self.kind != "around":
            got = toml_brief(self.spread_deg)
            raise mistake('none unless kind = "around"', got, key="spread_deg")
        if self.kind == "sampler" and found:
            expected = 'no poses with "sampler", which makes its own'
            raise mistake(expected, f"{len(found)} poses", key="kind")
        if self.kind != "sampler" and not found:
            raise mistake('poses, such as "letters" or ["A", "B"]', "nothing", key="names")
        if self.kind == "interpolation" and len(found) < 2:
            raise mistake("at least two poses to interpolate between", f"{len(found)}", key="names")
        names = [pose.name for pose in found]
        for name in sorted({n for n in names if names.count(n) > 1}):
            raise mistake("poses with different names", f"'{name}' more than once", key="files")
        # Where they came from does not count.
        self.__dict__.update(names=(), files=(), resolved=found)
        return self


class RigFile(FileRecord):
    """A rigged hand from a file; see `clradar.rigs.read_rig`.

    `file` and `mapping` are relative to the plan's folder; `sha256` and `mapping_sha256` of their
    content, and `handedness`, which is given or estimated, are filled in when the plan is read.
    """

    file: str
    sha256: str
    handedness: Annotated[str, choice("right", "left")]
    mapping: str | None = None
    mapping_sha256: str | None = None
    unit: str | float | None = None
    betas: tuple[float, ...] = ()


def _rig(given: Any, info: ValidationInfo) -> Any:
    """The record of a rig whose file is read once, so that one that is no rig is found at once."""
    value = {"file": given} if isinstance(given, str) else given
    if not isinstance(value, dict) or "sha256" in value:
        return value
    for key in ("file", "mapping"):
        text = value.get(key)
        if (text is not None or key == "file") and not (isinstance(text, str) and text):
            raise mistake("the name of a file", toml_brief(text), key=key)
    known = ("file", "mapping", "unit", "handedness", "betas")
    if unknown := [key for key in value if key not in known]:
        raise mistake(f"the keys {', '.join(known)}", unknown[0])
    return {**value, **tried(_found_rig, value, folder_of(info))}


def _found_rig(value: dict[str, Any], folder: Path) -> dict[str, Any]:
    from clradar.rigs import read_rig

    path = folder / value["file"]
    names = None if value.get("mapping") is None else folder / value["mapping"]
    options = {key: value[key] for key in ("unit", "handedness", "betas") if key in value}
    try:
        rig = read_rig(path, mapping=names, **options)
    except ClradarError as error:  # it names the option of the command
        raise MeasurementError(str(error).replace("--mapping", "the key mapping")) from error
    found = {"sha256": sha256_of(path), "handedness": rig.handedness}
    return found if names is None else {**found, "mapping_sha256": sha256_of(names)}


class ShapeTable(FileRecord):
    """A shape of `shapes`, with lengths in millimetres, or as in manifests in metres."""

    length_mm: Annotated[float, number(*(1e3 * v for v in LENGTH_LIMITS_M))] | None = None
    breadth_mm: Annotated[float, number(*(1e3 * v for v in BREADTH_LIMITS_M))] | None = None
    length_m: Annotated[float, number(*LENGTH_LIMITS_M)] | None = None
    breadth_m: Annotated[float, number(*BREADTH_LIMITS_M)] | None = None
    finger_lengths: Annotated[tuple[float, ...], floats(5)] = AVERAGE.finger_lengths
    girth: Annotated[float, number(*FACTOR_LIMITS)] = AVERAGE.girth

    @model_validator(mode="after")
    def _check(self) -> ShapeTable:
        for name in ("length", "breadth"):
            value_m, value_mm = getattr(self, f"{name}_m"), getattr(self, f"{name}_mm")
            if value_m is None:
                value_m = getattr(AVERAGE, f"{name}_m") if value_mm is None else value_mm / 1e3
            self.__dict__.update({f"{name}_m": value_m, f"{name}_mm": None})
        tried(lambda: self.shape)
        return self

    @property
    def shape(self) -> HandShape:
        values: Any = (self.length_m, self.breadth_m, self.finger_lengths, self.girth)
        return HandShape(*values)


class Hands(FileRecord):
    """The table [hands].

    `handedness` "both": with equal probabilities; a rig of the other hand is mirrored, unless
    "as it is". `shape` is "default", "sampled" or "list": of `shapes`, with equal probabilities.
    `rigs` take the place of shapes.
    """

    handedness: str = "right"
    shape: Annotated[str, choice("default", "sampled", "list")] = "default"
    shapes: tuple[ShapeTable, ...] = ()
    rigs: tuple[Annotated[RigFile, BeforeValidator(_rig)], ...] = ()
    edge_mm: Annotated[float, number(0.5, 4.0)] = EDGE_MM

    @model_validator(mode="after")
    def _check(self) -> Hands:
        sides = ("right", "left", "both", *(("as it is",) if self.rigs else ()))
        if "handedness" not in self.model_fields_set:
            self.__dict__["handedness"] = sides[-1] if self.rigs else "right"
        if self.handedness not in sides:
            got = toml_brief(self.handedness)
            raise mistake(choice_text(self.handedness, sides), got, key="handedness")
        if "shape" not in self.model_fields_set and self.shapes:
            self.__dict__["shape"] = "list"
        if (self.shape == "list") != bool(self.shapes):
            expected = 'a list of shapes with shape = "list", and else none'
            raise mistake(expected, toml_brief(self.shape), key="shapes")
        if self.rigs and self.shape != "default":
            expected = "none with rigs, which have shapes of their own"
            raise mistake(expected, toml_brief(self.shape), key="shape")
        return self


class Placement(FileRecord):
    """The table [placement]: centre of the hand's bounding box, and rotation about it."""

    x_mm: Side = fixed(0.0)
    y_mm: Side = fixed(0.0)
    z_mm: Annotated[Draw, draws(NEAREST_MM, FARTHEST_MM)] = fixed(300.0)
    rotation_x_deg: Turn = fixed(0.0)
    rotation_y_deg: Turn = fixed(0.0)
    rotation_z_deg: Turn = fixed(0.0)


class MovementPlan(FileRecord):
    """The table [movement]: consecutive samples are the frames of a sequence.

    With `poses` "next" the hand goes from its pose to another, drawn like it, until the last frame;
    with "stay" it keeps it; in recipes `last` is that pose. `x_mm` to `rotation_z_deg` say how far
    it has moved and turned in the last frame; `order` and `step_us` when samples are recorded
    (`clradar.SweepTiming.in_order`).
    """

    frames: Annotated[int, whole(2, MOST_FRAMES)] = 8
    rate_hz: Annotated[float, number(0.0, 1e6, above=True)] = RATE_HZ
    poses: Annotated[str, choice("next", "stay")] = "next"
    last: Annotated[HandPose, Value(_of_record, {"type": "object"})] | None = None
    x_mm: Side = fixed(0.0)
    y_mm: Side = fixed(0.0)
    z_mm: Side = fixed(0.0)
    rotation_x_deg: Turn = fixed(0.0)
    rotation_y_deg: Turn = fixed(0.0)
    rotation_z_deg: Turn = fixed(0.0)
    order: Annotated[str, choice(*ORDERS)] = "tx"
    step_us: Annotated[float, number(0.0, 1e6)] = 1e6 * STEP_S


class Alpha(FileRecord):
    """Roughness of a hand, by part; `others` is one value for all parts without their own."""

    palm: Share | None = None
    thumb: Share | None = None
    index: Share | None = None
    middle: Share | None = None
    ring: Share | None = None
    pinky: Share | None = None
    others: Share = fixed(0.5)

    @property
    def of_parts(self) -> Mapping[str, float]:
        """The alpha of every part of a sample, of which nothing is to be drawn."""
        return {name: (getattr(self, name) or self.others).values[0] for name in PART_NAMES}


def alpha_of(value: Any) -> Any:
    """The table of a value for all parts."""
    names = (*PART_NAMES, "others")
    if isinstance(value, Alpha) or (
        isinstance(value, dict) and (len(value) != 1 or next(iter(value)) in names)
    ):
        return value
    return Alpha(others=draws(0.0, 1.0, ("uniform", "choice")).read(value))


AlphaOfParts = Annotated[Alpha, BeforeValidator(alpha_of)]

"""The tables [poses], [hands], [placement], [movement], alpha and material of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from pydantic import (
    AliasChoices,
    BeforeValidator,
    Field,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from clradar.constants import PLAUSIBLE_COATING_M, PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.dataset.plan.draws import Draw, Within, fixed, tried
from clradar.errors import ClradarError, ModelError
from clradar.files.failures import clean, fail, reading, regular_file_size
from clradar.files.hashing import sha256_of
from clradar.files.meshes.gltf_document import files_of
from clradar.files.records import FileRecord, Number, NumberOrText, Numbers, Text, mistake
from clradar.files.toml_file import choice_text, nearest, toml_brief
from clradar.hand import (
    DIGITS,
    LETTERS,
    PART_NAMES,
    HandPose,
    HandShape,
    JointAngles,
)
from clradar.hand.pose_file import pose_of
from clradar.hand.sampler import MOST_SPREAD_DEG, SPREAD_DEG
from clradar.hand.shape import AVERAGE, BREADTH_LIMITS_M, FACTOR_LIMITS, LENGTH_LIMITS_M
from clradar.model.known_materials import KNOWN, material
from clradar.model.material import Material
from clradar.model.material_file import SUFFIXES, material_of, read_materials
from clradar.motion.instants import RATE_HZ, STEP_S

POSE_SETS = {"letters": LETTERS, "digits": DIGITS, "all": (*LETTERS, *DIGITS)}
"""Names of sets of poses."""

EDGE_MM = 2.0  # about 29 000 faces; see docs/datasets.md for what other lengths cost and err
NAME_OR_TABLE = WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]})

Value = TypeVar("Value")

Side = Annotated[Draw, Within(-1000.0, 1000.0)]
Turn = Annotated[Draw, Within(-360.0, 360.0)]
Share = Annotated[Draw, Within(0.0, 1.0)]


def pose_record(pose: HandPose) -> dict[str, Any]:
    """Return name and angles, without joints whose angles are all 0."""
    joints = {joint: [*astuple(angles)] for joint, angles in pose.joints.items()}
    return {"name": pose.name, "joints_rad": joints}


def different(values: Any, key: str = "") -> Any:
    """Return values, or raise a mistake if one is there twice."""
    if twice := sorted({value for value in values if values.count(value) > 1}):
        raise mistake("each of them once", f"{', '.join(map(str, twice))} more often", key=key)
    return values


def folder_of(info: ValidationInfo) -> Path:
    """What names of files in a plan are relative to."""
    return Path() if info.context is None else info.context["folder"]


def _of_set(value: Any) -> Any:
    if isinstance(value, str) and value not in POSE_SETS:
        raise mistake(choice_text(value, (*POSE_SETS, "a list of names")))
    return POSE_SETS[value] if isinstance(value, str) else value


def _pose(value: Any, info: ValidationInfo) -> Any:
    """Return the pose of a name, a file, or as it is in manifests."""
    if isinstance(value, HandPose):
        return value
    if isinstance(value, str) and info.field_name != "resolved":  # manifests name no files
        return tried(pose_of, folder_of(info) / value if Path(value).suffix else value)
    try:
        joints = {name: JointAngles(*angles) for name, angles in value["joints_rad"].items()}
        return HandPose(value["name"], joints)
    except (ClradarError, KeyError, TypeError, AttributeError, ValueError) as error:
        got = clean(error) if isinstance(error, ClradarError) else None
        raise mistake("the name of a pose, or name and joints_rad", got) from error


Pose = Annotated[HandPose, PlainValidator(_pose), NAME_OR_TABLE]
_NAMES = WithJsonSchema(
    {"anyOf": [{"enum": list(POSE_SETS)}, {"type": "array", "items": {"type": "string"}}]}
)


UNNAMED = "[all]"  # key of a value that a file gives without one; mistakes are not reported at it


class Short(FileRecord):
    """A table in whose place one of its values may be given: that with the alias `UNNAMED`."""

    @classmethod
    def is_table(cls, value: Any) -> bool:
        return isinstance(value, dict)

    @model_validator(mode="before")
    @classmethod
    def _of_one(cls, value: Any) -> Any:
        return value if isinstance(value, cls) or cls.is_table(value) else {UNNAMED: value}

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Any:
        table = handler(schema)
        name = next(name for name, own in cls.model_fields.items() if own.validation_alias)
        return {"anyOf": [handler.resolve_ref_schema(table)["properties"][name], table]}


def short(name: str, **default: Any) -> Any:
    """Return the field that may stand for its table."""
    return Field(validation_alias=AliasChoices(name, UNNAMED), **default)


class Poses(FileRecord):
    """The table [poses]: a pose of the list; one between two of them; one drawn around a pose of
    the list; or a random one within the limits of joints ("sampler").

    `resolved` has those of `names`, of `files`, and of manifests in the end. Sample i has pose i
    modulo their number, or a random one. Of "interpolation" `share` 0 is the first of the two
    poses, 1 the second; `spread_deg` is the standard deviation of "around".
    """

    kind: Literal["list", "interpolation", "around", "sampler"] = "list"
    names: Annotated[tuple[Pose, ...], BeforeValidator(_of_set), _NAMES] = ()
    files: tuple[Pose, ...] = ()
    resolved: tuple[Pose, ...] = ()
    order: Literal["cycle", "random"] = "cycle"
    share: Share | None = None
    spread_deg: Annotated[float, Within(0.0, MOST_SPREAD_DEG)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Poses:
        kind, found = self.kind, (*self.names, *self.files, *self.resolved)
        for key, own in (("share", "interpolation"), ("spread_deg", "around")):
            if kind != own and getattr(self, key) is not None:
                raise mistake(f'none unless kind = "{own}"', f'kind = "{kind}"', key=key)
        if kind == "sampler" and found:
            expected = 'no poses with "sampler", which makes its own'
            raise mistake(expected, f"{len(found)} poses", key="kind")
        if kind != "sampler" and not found:
            raise mistake('poses, such as "letters" or ["A", "B"]', "nothing", key="names")
        if kind == "interpolation" and len(found) < 2:
            raise mistake("at least two poses to interpolate between", f"{len(found)}", key="names")
        different([pose.name for pose in found], "names")
        values: dict[str, Any] = {"names": (), "files": (), "resolved": found}
        if kind == "interpolation":
            values["share"] = self.share or Draw("uniform", (0.0, 1.0))
        if kind == "around" and self.spread_deg is None:
            values["spread_deg"] = SPREAD_DEG
        self.__dict__.update(values)  # where poses came from does not count
        return self


class RigFile(Short):
    """A rigged hand from a file; see `clradar.rigs.read_rig`.

    `file` and `mapping` are relative to the plan's folder; `sha256` and `mapping_sha256` of their
    content, and `handedness`, which is given or estimated, are filled in when the plan is read.
    """

    file: Text = short("file")
    sha256: str = ""
    handedness: Literal["right", "left"] | None = None
    mapping: Text | None = None
    mapping_sha256: str | None = None
    unit: NumberOrText | None = None
    betas: Numbers = ()

    @model_validator(mode="after")
    def _read_once(self, info: ValidationInfo) -> RigFile:
        """Read the files of a plan, so that one that is no rig is found at once."""
        if not self.sha256:
            rig, files = tried(self.read, folder_of(info)), self.files(folder_of(info))
            digests = {name: sha256_of(*files_of(path)) for name, path in files.items()}
            self.__dict__.update(digests, handedness=rig.handedness)
        return self

    def files(self, folder: Path) -> dict[str, Path]:
        """The files in a folder, by the names of their SHA-256."""
        names = {"sha256": self.file, "mapping_sha256": self.mapping}
        return {key: folder / name for key, name in names.items() if name is not None}

    def read(self, folder: Path) -> Any:
        """Return the rig of the files in a folder."""
        from clradar.rigs import read_rig

        files = self.files(folder)
        return read_rig(
            files["sha256"], mapping=files.get("mapping_sha256"), unit=self.unit,
            handedness=self.handedness, betas=self.betas or None,
        )  # fmt: skip

    def check(self, folder: Path) -> None:
        """Raise `ModelError` unless the files in a folder are those of the plan."""
        for name, path in self.files(folder).items():
            wanted = getattr(self, name)
            expected = f"the file of the plan (SHA-256 {wanted})"
            regular_file_size(path, expected, error=ModelError)
            with reading(path, expected, error=ModelError):
                if sha256_of(*files_of(path)) != wanted:
                    fail(path, expected, "another", error=ModelError)


class ShapeTable(FileRecord):
    """A shape of `shapes`, with lengths in millimetres, or as in manifests in metres."""

    length_mm: Annotated[float, Within(*(1e3 * v for v in LENGTH_LIMITS_M))] | None = None
    breadth_mm: Annotated[float, Within(*(1e3 * v for v in BREADTH_LIMITS_M))] | None = None
    length_m: Annotated[float, Within(*LENGTH_LIMITS_M)] = AVERAGE.length_m
    breadth_m: Annotated[float, Within(*BREADTH_LIMITS_M)] = AVERAGE.breadth_m
    finger_lengths: tuple[Number, Number, Number, Number, Number] = AVERAGE.finger_lengths
    girth: Annotated[float, Within(*FACTOR_LIMITS)] = AVERAGE.girth

    @model_validator(mode="after")
    def _check(self) -> ShapeTable:
        for name in ("length", "breadth"):
            if (value_mm := getattr(self, f"{name}_mm")) is not None:
                if f"{name}_m" in self.model_fields_set:
                    raise mistake(f"one of it and {name}_mm", "both", key=f"{name}_m")
                self.__dict__.update({f"{name}_m": value_mm / 1e3, f"{name}_mm": None})
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

    handedness: Literal["as it is", "right", "left", "both"] = "right"
    shape: Literal["default", "sampled", "list"] | None = None
    shapes: tuple[ShapeTable, ...] = ()
    rigs: tuple[RigFile, ...] = ()
    edge_mm: Annotated[float, Within(0.5, 4.0)] = EDGE_MM

    @model_validator(mode="after")
    def _check(self) -> Hands:
        if self.rigs and "handedness" not in self.model_fields_set:
            self.__dict__["handedness"] = "as it is"
        if self.handedness == "as it is" and not self.rigs:
            raise mistake("rigs with it", "none", key="handedness")
        self.__dict__["shape"] = shape = self.shape or ("list" if self.shapes else "default")
        if (shape == "list") != bool(self.shapes):
            got = f"{toml_brief(shape)} and {len(self.shapes)} shapes"
            raise mistake('a list of shapes with shape = "list" only', got, key="shapes")
        if self.rigs and shape != "default":
            raise mistake("none with rigs, which have their own", toml_brief(shape), key="shape")
        return self


class Motion(FileRecord):
    """A shift, and turns about the fixed axes x, then y, then z."""

    x_mm: Side = fixed(0.0)
    y_mm: Side = fixed(0.0)
    z_mm: Side = fixed(0.0)
    rotation_x_deg: Turn = fixed(0.0)
    rotation_y_deg: Turn = fixed(0.0)
    rotation_z_deg: Turn = fixed(0.0)

    @property
    def metres(self) -> list[float]:
        return [float(draw) / 1e3 for draw in (self.x_mm, self.y_mm, self.z_mm)]

    @property
    def radians(self) -> list[float]:
        turns = (self.rotation_x_deg, self.rotation_y_deg, self.rotation_z_deg)
        return [float(np.deg2rad(float(draw))) for draw in turns]


class Placement(Motion):
    """The table [placement]: centre of the hand's bounding box, and rotation about it."""

    z_mm: Annotated[Draw, Within(100.0, 3000.0)] = fixed(300.0)


class MovementPlan(Motion):
    """The table [movement]: consecutive samples are the frames of a sequence.

    With `poses` "next" the hand goes from its pose to another, drawn like it, until the last frame;
    with "stay" it keeps it; in recipes `last` is that pose. `x_mm` to `rotation_z_deg` say how far
    it has moved and turned in the last frame; `order` and `step_us` when samples are recorded
    (`clradar.SweepTiming.in_order`).
    """

    frames: Annotated[int, Within(2, 10_000)] = 8
    rate_hz: Annotated[float, Within(0.0, 1e6, above=True)] = RATE_HZ
    poses: Literal["next", "stay"] = "next"
    last: Pose | None = None
    order: Literal["tx", "frequency"] = "tx"
    step_us: Annotated[float, Within(0.0, 1e6)] = 1e6 * STEP_S


class ByPart(Short, Generic[Value]):
    """A value for each part of a hand; `others` is one value for all parts without their own."""

    palm: Value | None = None
    thumb: Value | None = None
    index: Value | None = None
    middle: Value | None = None
    ring: Value | None = None
    pinky: Value | None = None
    others: Value

    made: ClassVar[Any]

    @property
    def of_parts(self) -> Mapping[str, Any]:
        """What is `made` of every part of a sample, of which nothing is to be drawn."""
        values = {name: getattr(self, name) for name in PART_NAMES}
        return {n: self.made(self.others if own is None else own) for n, own in values.items()}

    @classmethod
    def is_table(cls, value: Any) -> bool:
        """Not that of one value for all parts."""
        parts = (*PART_NAMES, "others")
        return isinstance(value, dict) and (not value or any(nearest(k, parts) for k in value))


class Alpha(ByPart[Share]):
    """Roughness of a hand, by part."""

    others: Share = short("others", default=fixed(0.5))
    made = float


# Materials


def _made_of(given: Any, info: ValidationInfo) -> Material:
    """Return the material of a name, ``FILE.toml:NAME``, or a table as in a file of materials."""
    if isinstance(given, Material):
        return given
    if isinstance(given, dict):
        return tried(material_of, given, "material")
    if not isinstance(given, str):
        raise mistake("the name of a material, FILE.toml:NAME, or a table", toml_brief(given))
    file, colon, name = given.rpartition(":")
    known: Mapping[str, Material] = KNOWN
    if colon and file.lower().endswith(SUFFIXES):
        known = tried(read_materials, folder_of(info) / file)
    else:
        name = given
    if name not in known:
        raise mistake(f"{choice_text(name, tuple(known))}, or FILE.toml:NAME", toml_brief(given))
    return known[name]


def _millimetres(low_m: float, high_m: float) -> Within:
    return Within(1e3 * low_m, 1e3 * high_m)


class PartMaterial(Short):
    """What a part of a hand is made of: a material, of which some lengths may be drawn."""

    of: Annotated[Material, PlainValidator(_made_of), NAME_OR_TABLE] = short(
        "of", default_factory=lambda: material("palm")
    )  # most of what a radar sees of a hand that is held towards it
    roughness_rms_mm: Annotated[Draw, _millimetres(0.0, PLAUSIBLE_ROUGHNESS_M[1])] | None = None
    correlation_length_mm: Annotated[Draw, _millimetres(*PLAUSIBLE_CORRELATION_M)] | None = None
    coating_thickness_mm: Annotated[Draw, _millimetres(*PLAUSIBLE_COATING_M)] | None = None

    @model_validator(mode="after")
    def _check(self) -> PartMaterial:
        if self.coating_thickness_mm is not None and self.of.coating is None:
            got = repr(self.of.name)
            raise mistake("a material with a coating", got, key="coating_thickness_mm")
        tried(lambda: (self.made(0), self.made(1)))
        return self

    def made(self, bound: int = 0) -> Material:
        """Return the material with its least or its greatest lengths: equal where all is drawn."""
        values: dict[str, Any] = {
            name.replace("_mm", "_m"): draw.bounds()[bound] / 1e3
            for name in ("roughness_rms_mm", "correlation_length_mm", "coating_thickness_mm")
            if (draw := getattr(self, name)) is not None
        }
        thickness_m = values.pop("coating_thickness_m", None)
        if thickness_m is not None and self.of.coating is not None:
            values["coating"] = replace(self.of.coating, thickness_m=thickness_m)
        return replace(self.of, **values)


class PlanMaterials(ByPart[PartMaterial]):
    """What a hand is made of, by part."""

    others: PartMaterial = short("others", default_factory=PartMaterial)
    made = staticmethod(PartMaterial.made)

"""The plan of a data set: one pydantic model for its file, its manifest, and editors' schema."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, PrivateAttr, ValidationError, model_validator

from clradar.dataset.plan.hands import (
    Alpha,
    AlphaOfParts,
    Hands,
    MovementPlan,
    Placement,
    Poses,
    pose_record,
    texts,
)
from clradar.dataset.plan.materials import MaterialsOfParts, PlanMaterials
from clradar.dataset.plan.radar import Image, Impairments, RadarPlan, SimulationPlan, plan_array
from clradar.dataset.plan.values import Draw, Value, whole
from clradar.errors import MeasurementError
from clradar.files.failures import shown
from clradar.files.limits import MAX_PLAN_BYTES
from clradar.files.records import FileRecord, mistake, mistakes_of, raise_mistakes
from clradar.files.toml_file import choice_text, read_toml, toml_brief
from clradar.hand import HandPose
from clradar.model import Material
from clradar.model.material_file import material_record

PRODUCTS = ("capture", "volume", "max_projection", "depth_map", "mesh", "joints")
"""Arrays that can be stored of a sample."""

IMAGES = ("volume", "max_projection", "depth_map")
"""Products that need an image."""

MAX_SAMPLES = 10**8
MAX_SHARD = 4096
MAX_SHARDS = 50_000
"""Limit of the manifest's size."""

EXPECTED = "a plan of a data set (a TOML file, see docs/plans.md)"


class PlanError(MeasurementError):
    """A plan has mistakes; of several the text has their number and one line for each.

    Attributes
    ----------
    mistakes : tuple of str
        One line each: file, key, what was expected, what was found.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import PlanError, read_plan
    >>> _ = Path("plan.toml").write_text('sampels = 3\\nposes.names = "letters"\\nalpha = 2')
    >>> try:
    ...     read_plan("plan.toml")
    ... except PlanError as error:
    ...     print(*error.mistakes, sep="\\n")
    plan.toml: samples: expected a value, got nothing
    plan.toml: alpha: expected values from 0 to 1, got 2
    plan.toml: sampels: unknown key; expected one of ... (did you mean 'samples'?)
    """


def _products(value: Any) -> tuple[str, ...]:
    for name in (given := texts(value, "products")):
        if name not in PRODUCTS:
            raise mistake(choice_text(name, PRODUCTS), toml_brief(name))
    if not given:
        raise mistake(f"at least one of {', '.join(PRODUCTS)}", "none")
    return tuple(name for name in PRODUCTS if name in given)


_PRODUCTS = {"type": "array", "items": {"enum": list(PRODUCTS)}, "minItems": 1}


class Output(FileRecord):
    """The table [output]: `PRODUCTS` to store, samples per shard, and level of gzip, 0 to 9."""

    products: Annotated[tuple[str, ...], Value(_products, _PRODUCTS)] = (
        "max_projection",
        "depth_map",
        "joints",
    )
    shard_size: Annotated[int, whole(1, MAX_SHARD)] = 64
    compression: Annotated[int, whole(0, 9)] = 1


class Plan(FileRecord):
    """The plan of a data set with all defaults filled in, as `read_plan` returns it.

    Attributes
    ----------
    simulation : SimulationPlan
        Resolved; each sample draws a seed of its own.
    alpha : Alpha or None
        None with the physical estimator.
    material : PlanMaterials or None
        Of the physical estimator.
    movement : MovementPlan or None

    Examples
    --------
    >>> from clradar.dataset import read_plan
    >>> plan = read_plan("plan.toml")
    >>> plan.n_shards, plan.shard_samples(0), [pose.name for pose in plan.poses.poses]
    (1, range(0, 2), ['A', 'B'])
    """

    seed: Annotated[int, whole(0, 2**63 - 1)] = 0
    samples: Annotated[int, whole(1, MAX_SAMPLES)]
    poses: Poses
    hands: Hands = Hands()
    placement: Placement = Placement()
    alpha: AlphaOfParts | None = None
    impairments: Impairments = Impairments()
    radar: RadarPlan = RadarPlan()
    simulation: SimulationPlan = SimulationPlan()
    image: Image = Image()
    output: Output = Output()
    material: MaterialsOfParts | None = None
    movement: MovementPlan | None = None

    _folder: Path = PrivateAttr(Path())

    @model_validator(mode="before")
    @classmethod
    def _with_poses(cls, value: Any) -> Any:
        return {"poses": {}, **value} if isinstance(value, dict) else value

    @model_validator(mode="after")
    def _with_surface(self) -> Plan:
        if self.simulation.estimator == "physical":
            self.__dict__["material"] = self.material or PlanMaterials()
        else:
            self.__dict__["alpha"] = self.alpha or Alpha()
        return self

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Plan) and self.__dict__ == other.__dict__

    __hash__ = None  # type: ignore[assignment]

    @property
    def folder(self) -> Path:
        """What the names of rig files are relative to. It does not count in comparisons: the same
        plan in another folder is equal."""
        return self._folder

    @property
    def n_shards(self) -> int:
        return -(-self.samples // self.output.shard_size)

    def shard_samples(self, shard: int) -> range:
        """Return the indices of the samples of one shard."""
        first = shard * self.output.shard_size
        return range(first, min(first + self.output.shard_size, self.samples))

    @property
    def keeps_images(self) -> bool:
        return any(product in IMAGES for product in self.output.products)

    @property
    def needs_capture(self) -> bool:
        return self.keeps_images or "capture" in self.output.products


def read_plan(path: str | os.PathLike[str]) -> Plan:
    """Return the plan of a TOML file; docs/plans.md lists its keys.

    Raises
    ------
    PlanError
        Its `mistakes` has one line for each invalid key: the file, the key, what was expected, and
        what was found.
    MeasurementError
        The file is missing or no TOML.

    Examples
    --------
    >>> from clradar.dataset import read_plan
    >>> plan = read_plan("plan.toml")
    >>> plan.simulation.estimator, plan.placement.z_mm.values
    ('expected', (300.0,))
    """
    path = Path(path)
    parsed = read_toml(path, EXPECTED, limit=MAX_PLAN_BYTES)
    return plan_from(parsed, shown(path), path.absolute().parent)


def plan_from(parsed: Mapping[str, Any], source: str, folder: Path) -> Plan:
    """Return the plan of a mapping from TOML or JSON.

    `source` is the name of its file, for messages; names of other files are relative to `folder`.
    """
    try:
        plan = Plan.model_validate(dict(parsed), context={"folder": folder})
    except ValidationError as found:
        raise_mistakes(mistakes_of(found, Plan, source), PlanError, found)
    plan._folder = folder.absolute()
    contradictions = [
        f"{shown(source)}: {key}: expected {expected}, got {got}"
        for key, expected, got in _contradictions(plan)
    ]
    if contradictions:
        raise_mistakes(contradictions, PlanError)
    return plan


def _contradictions(plan: Plan) -> Iterator[tuple[str, str, str]]:
    """Yield key, expected and got of contradictions between tables."""
    estimator = plan.simulation.estimator
    if plan.material is not None and plan.alpha is not None:
        if estimator == "physical":
            yield "alpha", "material in its place with simulation.estimator physical", "alpha"
        else:
            yield "material", "simulation.estimator physical with it", estimator
    if plan.n_shards > MAX_SHARDS:
        least = -(-plan.samples // MAX_SHARDS)
        expected = f"at least {least} for {plan.samples} samples ({MAX_SHARDS} files)"
        yield "output.shard_size", expected, f"{plan.output.shard_size}"
    channels = plan.impairments.channels
    if channels is not None:
        array = plan_array(plan.radar.array, plan.radar.every)
        for key, count in (("dead_tx", array.n_tx), ("dead_rx", array.n_rx)):
            last = max(getattr(channels, key), default=0)
            if last >= count:
                expected = f"channels from 0 to {count - 1}"
                yield f"impairments.channels.{key}", expected, f"{last}"
    if plan.impairments.any and not plan.needs_capture:
        expected = "a product that they change (capture, volume, max_projection or depth_map)"
        yield "impairments", expected, ", ".join(plan.output.products)
    if plan.movement is not None:
        if plan.samples % plan.movement.frames:
            expected = f"a multiple of movement.frames, {plan.movement.frames}"
            yield "samples", expected, f"{plan.samples}"
        if plan.hands.rigs:
            yield "movement", "hands without rigs", "hands.rigs"
    for key in ("x_mm", "y_mm", "z_mm") if plan.keeps_images else ():
        drawn: Draw = getattr(plan.placement, key)
        least_mm, greatest_mm = drawn.bounds()
        if drawn.kind == "normal":
            least_mm = greatest_mm = drawn.values[0]
        first, last = getattr(plan.image, key)
        if not first <= least_mm <= greatest_mm <= last:
            expected = f"hands in the image (image.{key} is {first:g} to {last:g})"
            yield f"placement.{key}", expected, f"{least_mm:g} to {greatest_mm:g}"


def plan_record(plan: Plan) -> dict[str, Any]:
    """Return a plan in the vocabulary of plan files, every key written out, so that `plan_from`
    gives it back to the last bit.

    Poses are written out with their angles: the record does not change when the poses of the
    package or the pose files do.
    """
    record: dict[str, Any] = _plain(plan)
    if plan.poses.kind != "interpolation":
        del record["poses"]["share"]
    if plan.poses.kind != "around":
        del record["poses"]["spread_deg"]
    return record


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        pairs = ((name, getattr(value, name)) for name in type(value).model_fields)
        return {name: _plain(item) for name, item in pairs if item is not None and item != ()}
    if isinstance(value, Draw):
        return value.to_plain()
    if isinstance(value, HandPose):
        return pose_record(value)
    if isinstance(value, Material):
        return material_record(value)
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def plan_schema() -> dict[str, Any]:
    """Return the JSON schema of plans, for editors that complete and check TOML files.

    Examples
    --------
    >>> from clradar.dataset import plan_schema
    >>> sorted(plan_schema()["properties"])[:3]
    ['alpha', 'hands', 'image']
    """
    return Plan.model_json_schema()

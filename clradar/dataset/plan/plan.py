"""The plan of a data set: one pydantic model for its file, its manifest, and editors' schema."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import AfterValidator, BaseModel, Field, model_validator

from clradar.dataset.plan.draws import Draw, Within
from clradar.dataset.plan.hands import (
    Alpha,
    Hands,
    MovementPlan,
    Placement,
    PlanMaterials,
    Poses,
    different,
    pose_record,
)
from clradar.dataset.plan.radar import Image, Impairments, RadarPlan, SimulationPlan
from clradar.errors import MeasurementError
from clradar.files.failures import shown
from clradar.files.limits import MAX_LONG_TOML_BYTES
from clradar.files.records import FileRecord, mistake, raise_mistakes, record_of
from clradar.files.toml_file import read_toml
from clradar.hand import HandPose
from clradar.model import Material
from clradar.model.material_file import material_record

Product = Literal["capture", "volume", "max_projection", "depth_map", "mesh", "joints"]

PRODUCTS: tuple[str, ...] = get_args(Product)
IMAGES = ("volume", "max_projection", "depth_map")  # products that need an image
MAX_SHARDS = 50_000  # limit of the manifest's size
EXPECTED = "a plan of a data set (a TOML file, see docs/plans.md)"


class PlanError(MeasurementError):
    """A plan has `mistakes`, a line for each: file, key, what was expected, what was found.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("plan.toml").write_text('sampels = 3\\nposes.names = "letters"')
    >>> try:
    ...     clradar.dataset.read_plan("plan.toml")
    ... except clradar.dataset.PlanError as error:
    ...     print(*error.mistakes, sep="\\n")
    plan.toml: samples: expected a value, got nothing
    plan.toml: sampels: unknown key; expected one of ... (did you mean 'samples'?)
    """


def _products(given: tuple[str, ...]) -> tuple[str, ...]:
    if not given:
        raise mistake(f"at least one of {', '.join(PRODUCTS)}", "none")
    return tuple(name for name in PRODUCTS if name in different(given))


class Output(FileRecord):
    """The table [output]: what to store, samples per shard, and level of gzip, 0 to 9."""

    products: Annotated[tuple[Product, ...], AfterValidator(_products)] = (
        "max_projection",
        "depth_map",
        "joints",
    )
    shard_size: Annotated[int, Within(1, 4096)] = 64
    compression: Annotated[int, Within(0, 9)] = 1


class Plan(FileRecord):
    """The plan of a data set with all defaults filled in, as `read_plan` returns it.

    Its attributes are the tables of docs/plans.md; `alpha` is None with the physical estimator,
    `material` without it, `movement` of still hands.
    """

    seed: Annotated[int, Within(0, 2**63 - 1)] = 0
    samples: Annotated[int, Within(1, 10**8)]
    poses: Annotated[Poses, Field(default_factory=dict, validate_default=True)]
    hands: Hands = Hands()
    placement: Placement = Placement()
    alpha: Alpha | None = None
    impairments: Impairments = Impairments()
    radar: RadarPlan = RadarPlan()
    simulation: SimulationPlan = SimulationPlan()
    image: Image = Image()
    output: Output = Output()
    material: PlanMaterials | None = None
    movement: MovementPlan | None = None

    # What names of rig files are relative to; the same plan elsewhere is equal.
    folder: ClassVar[Path] = Path()

    @model_validator(mode="after")
    def _with_surface(self) -> Plan:
        if self.simulation.estimator == "physical":
            self.__dict__["material"] = self.material or PlanMaterials()
        else:
            self.__dict__["alpha"] = self.alpha or Alpha()
        return self

    @property
    def n_shards(self) -> int:
        return -(-self.samples // self.output.shard_size)

    def shard_samples(self, shard: int) -> range:
        """Return the indices of the samples of one shard."""
        first = shard * self.output.shard_size
        return range(first, min(first + self.output.shard_size, self.samples))

    @property
    def pose_names(self) -> tuple[str, ...]:
        """Names that poses of samples have; none where they are between two, or random."""
        stay = self.movement is None or self.movement.poses == "stay"
        named = stay and self.poses.kind in ("list", "around")
        return tuple(pose.name for pose in self.poses.resolved) if named else ()

    @property
    def keeps_images(self) -> bool:
        return any(product in IMAGES for product in self.output.products)

    @property
    def needs_capture(self) -> bool:
        return self.keeps_images or "capture" in self.output.products


def read_plan(path: str | os.PathLike[str]) -> Plan:
    """Return the plan of a TOML file (docs/plans.md); mistakes in its keys are a `PlanError`.

    Examples
    --------
    >>> plan = clradar.dataset.read_plan("plan.toml")
    >>> plan.simulation.estimator, plan.placement.z_mm.values
    ('expected', (300.0,))
    """
    path = Path(path)
    parsed = read_toml(path, EXPECTED, limit=MAX_LONG_TOML_BYTES)
    return plan_from(parsed, shown(path), path.absolute().parent)


def plan_from(parsed: Any, source: str, folder: Path) -> Plan:
    """Return the plan of a parsed table; `source` is named in messages, files in `folder`."""
    plan = record_of(parsed, Plan, source, error=PlanError, context={"folder": folder})
    plan.__dict__["folder"] = folder.absolute()
    contradictions = [
        f"{shown(source)}: {key}: expected {expected}, got {got}"
        for key, expected, got in _contradictions(plan)
    ]
    if contradictions:
        raise_mistakes(contradictions, PlanError)
    return plan


def _contradictions(plan: Plan) -> Iterator[tuple[str, str, Any]]:
    """Yield key, expected and got of contradictions between tables."""
    estimator, movement = plan.simulation.estimator, plan.movement
    if plan.material is not None and plan.alpha is not None:
        if estimator == "physical":
            yield "alpha", 'material in its place with simulation.estimator = "physical"', "alpha"
        else:
            yield "material", 'simulation.estimator = "physical" with it', f'"{estimator}"'
    if plan.n_shards > MAX_SHARDS:
        least = -(-plan.samples // MAX_SHARDS)
        expected = f"at least {least} for {plan.samples} samples ({MAX_SHARDS} files)"
        yield "output.shard_size", expected, plan.output.shard_size
    if plan.impairments.channels is not None:
        array, channels = plan.radar.antennas, plan.impairments.channels
        for key, count in (("dead_tx", array.n_tx), ("dead_rx", array.n_rx)):
            last = max(getattr(channels, key), default=0)
            if last >= count:
                yield f"impairments.channels.{key}", f"channels from 0 to {count - 1}", last
    if plan.impairments.any and not plan.needs_capture:
        expected = "a product that they change (capture, volume, max_projection or depth_map)"
        yield "impairments", expected, ", ".join(plan.output.products)
    if movement is not None and plan.samples % movement.frames:
        yield "samples", f"a multiple of movement.frames, {movement.frames}", plan.samples
    if movement is not None and plan.hands.rigs:
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


def plan_record(value: Any) -> Any:
    """Return a plan, or a value of it, as `plan_from` gives it back to the last bit: every key and
    all angles of poses written out, whatever defaults and poses come later."""
    if isinstance(value, BaseModel):
        pairs = ((name, getattr(value, name)) for name in type(value).model_fields)
        return {name: plan_record(item) for name, item in pairs if item is not None and item != ()}
    if isinstance(value, Draw):
        return value.to_plain()
    if isinstance(value, HandPose):
        return pose_record(value)
    if isinstance(value, Material):
        return material_record(value)
    return [plan_record(item) for item in value] if isinstance(value, tuple) else value


def plan_schema() -> dict[str, Any]:
    """Return the JSON schema of plans, for editors that complete and check TOML files.

    Examples
    --------
    >>> sorted(clradar.dataset.plan_schema()["properties"])[:3]
    ['alpha', 'hands', 'image']
    """
    return Plan.model_json_schema()

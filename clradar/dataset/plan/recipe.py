"""The recipe of one sample: the plan with a number in place of every draw."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from pydantic import BaseModel

from clradar.dataset.plan.draws import Draw, fixed, stream
from clradar.dataset.plan.hands import Hands, MovementPlan, Poses, ShapeTable
from clradar.dataset.plan.plan import Plan, plan_record
from clradar.errors import ModelError
from clradar.files.failures import clean
from clradar.files.records import record_of
from clradar.hand import (
    HandPose,
    interpolate_poses,
    pose_around,
    random_pose,
    random_shape,
)
from clradar.hand.pose import minimum_jerk
from clradar.model import checks

VERSION = 3
SEED_BITS = 63

Recipe = dict[str, Any]
"""JSON values only: the keys of a plan, the number of the sample, and the version of recipes."""


def recipe(plan: Plan, index: int) -> Recipe:
    """Return the plan of sample `index` alone, from which `make_sample` reproduces it.

    It has the keys and the units of a plan, every one written out, with a number in place of every
    draw. Each quantity's random numbers are keyed by the plan's seed, the sample and the quantity's
    path: a recipe depends neither on other samples nor on other draws.

    Examples
    --------
    >>> second = clradar.dataset.recipe(clradar.dataset.read_plan("plan.toml"), 1)
    >>> second["poses"]["resolved"][0]["name"], second["placement"]["z_mm"]
    ('B', 300.0)
    """
    return SamplePlan(plan, checks.whole("sample", index, 0, plan.samples - 1)).record


def read_recipe(recipe: Mapping[str, Any] | str | bytes) -> SamplePlan:
    """Return the sample of a recipe or its JSON text; what is a draw in it is drawn."""
    try:
        found: Any = json.loads(recipe) if isinstance(recipe, str | bytes) else recipe
    except ValueError as error:
        raise ModelError(f"recipe: expected its JSON text, got no JSON: {clean(error)}") from error
    if not isinstance(found, Mapping):
        checks.fail("recipe", "a mapping, or its JSON text", type(found).__name__)
    content = dict(found)
    version, sample = content.pop("version", VERSION), content.pop("sample", 0)
    if version != VERSION:
        older = "older ones follow from their plan: clradar.dataset.recipe(plan, sample)"
        checks.fail("recipe", f"version {VERSION}", f"{version!r}; {older}")
    plan = record_of(content, Plan, "recipe", error=ModelError)
    return SamplePlan(plan, checks.whole("recipe: sample", sample, 0))


class SamplePlan:
    """One sample: its number, and its `plan`, in which a number stands in place of every draw.

    All frames of a sequence have the draws of the sequence, and its `number`.
    """

    def __init__(self, plan: Plan, sample: int) -> None:
        self.sample = sample
        self.number = sample if plan.movement is None else sample // plan.movement.frames
        self._seed = plan.seed
        drawn: Plan = self._numbers(plan, "")
        first = self._first_pose(drawn.poses)
        more: dict[str, Any] = {
            "poses": Poses(resolved=(first,)),
            "hands": self._hands(drawn.hands),
            "simulation": self._seeded(drawn.simulation, "simulation.seed"),
        }
        if drawn.movement is not None:
            last = self._last_pose(drawn.movement, drawn.poses, first)
            more["movement"] = drawn.movement.model_copy(update={"last": last})
        if plan.impairments.any:
            impairments = self._seeded(drawn.impairments, "impairments.seed")
            channels = impairments.channels
            if channels is not None:  # one instrument for all has the draw of sample 0
                number = 0 if channels.per == "dataset" else self.number
                channels = self._seeded(channels, "impairments.channels.seed", number)
            more["impairments"] = impairments.model_copy(update={"channels": channels})
        self.plan: Plan = drawn.model_copy(update=more)

    def _numbers(self, node: Any, path: str) -> Any:
        if isinstance(node, Draw):
            return node if node.kind == "fixed" else fixed(node.draw(self._stream(path)))
        if not isinstance(node, BaseModel):
            return node
        above = f"{path}." if path else ""
        names = type(node).model_fields
        return node.model_copy(
            update={name: self._numbers(getattr(node, name), above + name) for name in names}
        )

    def _stream(self, quantity: str) -> np.random.Generator:
        return stream(self._seed, self.number, quantity)

    def _one_of(self, quantity: str, choices: tuple[Any, ...]) -> Any:
        return choices[int(self._stream(quantity).integers(len(choices)))]

    def _seeded(self, table: Any, quantity: str, number: int | None = None) -> Any:
        """A table with its seed, which is drawn unless it is given."""
        if table.seed is not None:
            return table
        random = stream(self._seed, self.number if number is None else number, quantity)
        return table.model_copy(update={"seed": int(random.integers(2**SEED_BITS))})

    def _first_pose(self, poses: Poses) -> HandPose:
        """The pose of a sample, or of the first frame of its sequence."""
        random = self._stream("poses")
        if poses.kind == "sampler":
            return random_pose(random)
        count = len(poses.poses)
        cycle = poses.order == "cycle"
        first = self.number % count if cycle else int(random.integers(count))
        pose = poses.poses[first]
        if poses.spread_deg is not None:
            return pose_around(pose, self._stream("poses.spread"), poses.spread_deg)
        if poses.share is None:
            return pose
        # Two different ones: the second is any but the first.
        second = (first + 1 + int(random.integers(count - 1))) % count
        return interpolate_poses(pose, poses.poses[second], float(poses.share))

    def _last_pose(self, movement: MovementPlan, poses: Poses, first: HandPose) -> HandPose:
        if movement.last is not None:
            return movement.last
        if movement.poses == "stay":
            return first
        if poses.kind == "sampler":
            return random_pose(self._stream("movement.pose"))
        last: HandPose = self._one_of("movement.pose", poses.poses)
        return last

    def _hands(self, hands: Hands) -> Hands:
        sides = ("right", "left") if hands.handedness == "both" else (hands.handedness,)
        side = self._one_of("hands.handedness", sides)
        if hands.rigs:
            rig = self._one_of("hands.rigs", hands.rigs)
            side = rig.handedness if side == "as it is" else side
            return hands.model_copy(update={"handedness": side, "rigs": (rig,)})
        shape = ShapeTable()
        if hands.shape == "sampled":
            shape = ShapeTable(**asdict(random_shape(self._stream("hands.shape"))))
        elif hands.shape == "list":
            shape = self._one_of("hands.shape", hands.shapes)
        return hands.model_copy(update={"handedness": side, "shape": "list", "shapes": (shape,)})

    @property
    def record(self) -> Recipe:
        """The recipe."""
        return {"version": VERSION, "sample": self.sample, **plan_record(self.plan)}

    @property
    def first(self) -> HandPose:
        return self.plan.poses.poses[0]

    @property
    def frame(self) -> int:
        """Its number in its sequence; 0 where nothing moves."""
        return 0 if self.plan.movement is None else self.sample % self.plan.movement.frames

    @property
    def start_s(self) -> float:
        """When its frame begins in its sequence."""
        return 0.0 if self.plan.movement is None else self.frame / self.plan.movement.rate_hz

    @property
    def middle_s(self) -> float:
        """The middle of the sweep of its frame, in its sequence."""
        radar, movement = self.plan.radar, self.plan.movement
        slots = radar.antennas.n_tx * radar.steps
        return self.start_s + (0.0 if movement is None else 0.5e-6 * (slots - 1) * movement.step_us)

    @property
    def pose(self) -> HandPose:
        """The pose of a sample; of a frame of a sequence that in the middle of its sweep."""
        movement = self.plan.movement
        if movement is None or movement.last is None:
            return self.first
        share = minimum_jerk(min(1.0, self.middle_s * movement.rate_hz / (movement.frames - 1)))
        if movement.last == self.first or share in (0.0, 1.0):
            return movement.last if share == 1.0 else self.first
        return interpolate_poses(self.first, movement.last, share)

"""The recipe of one sample: a function of the plan and the sample's number alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import BaseModel

from clradar.dataset.plan.draws import Draw, fixed, stream
from clradar.dataset.plan.hand_json import pose_record, shape_record
from clradar.dataset.plan.hands import MovementPlan, Placement, RigFile
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.radar import plan_array
from clradar.hand import (
    PART_NAMES,
    HandPose,
    HandShape,
    interpolate_poses,
    pose_around,
    random_pose,
    random_shape,
)
from clradar.hand.movement import minimum_jerk
from clradar.model import checks
from clradar.model.material_file import material_record

VERSION = 1
MOVING_VERSION = 2
"""Of recipes of frames of a sequence, which older programs would take for still hands."""

SEED_BITS = 63

EARLIER_SETTINGS = {"facets": "flat"}
"""What settings were before there was a key for them: recipes without it are older."""

IMAGING = ("method", "window", "tolerance_db", "dynamic_range_db")

Recipe = dict[str, Any]
"""JSON values only. Lengths in metres, angles in radians, frequencies in hertz."""


def recipe(plan: Plan, index: int) -> Recipe:
    """Return the drawn quantities of sample `index`, from which `make_sample` reproduces it.

    Every quantity has random numbers of its own, keyed by the plan's seed, the sample's number and
    the quantity's name (`clradar.dataset.plan.draws.stream`). So a recipe depends neither on other
    samples nor on other draws.

    Raises
    ------
    ModelError
        The plan has no such sample.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import read_plan, recipe
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> plan = read_plan("plan.toml")
    >>> found = recipe(plan, 1)
    >>> found["pose"]["name"], found["hand"]["handedness"], found["placement"]["center_m"]
    ('B', 'right', [0.0, 0.0, 0.3])
    """
    index = checks.whole("sample", index, 0, plan.samples - 1)
    impaired, drawn = plan.impairments.any, _Drawn(plan, index)
    plan, radar = drawn.plan, plan.radar
    return {
        "version": VERSION if plan.movement is None else MOVING_VERSION,
        "sample": index,
        "pose": pose_record(drawn.pose()),
        **_movement(drawn),
        "hand": _hand(drawn),
        "placement": {
            "center_m": _metres(plan.placement),
            "rotation_rad": _radians(plan.placement),
        },
        **_surface(plan),
        "radar": {
            "array": radar.array,
            "every": radar.every,
            "start_hz": radar.start_ghz * 1e9,
            "stop_hz": radar.stop_ghz * 1e9,
            "steps": radar.steps,
        },
        "simulation": _simulation(drawn),
        "impairments": _impairments(drawn) if impaired else None,
        "image": _image(plan) if plan.keeps_images else None,
        "products": list(plan.output.products),
    }


def pose_and_hand(plan: Plan, index: int) -> tuple[str, str]:
    """Return the name of the pose and the handedness of sample `index`, as its recipe has them."""
    drawn = _Drawn(plan, index)
    return drawn.pose().name, drawn.side_and_rig()[0]


class _Drawn:
    """The draws of one sample, or of its sequence, whose frames share them.

    In its `plan` a number stands in place of every draw.
    """

    def __init__(self, plan: Plan, index: int) -> None:
        self._seed, self.index = plan.seed, index
        self.number = index if plan.movement is None else index // plan.movement.frames
        self.plan: Plan = self._numbers(plan, "")

    def _numbers(self, node: Any, path: str) -> Any:
        if isinstance(node, Draw):
            return node if node.kind == "fixed" else fixed(node.draw(self.stream(path)))
        if not isinstance(node, BaseModel):
            return node
        values = {name: getattr(node, name) for name in type(node).model_fields}
        above = f"{path}." if path else ""
        return node.model_copy(
            update={name: self._numbers(value, above + name) for name, value in values.items()}
        )

    def stream(self, quantity: str) -> np.random.Generator:
        return stream(self._seed, self.number, quantity)

    def one_of(self, quantity: str, choices: tuple[Any, ...]) -> Any:
        return choices[int(self.stream(quantity).integers(len(choices)))]

    def seed(self, quantity: str, number: int | None = None) -> int:
        random = stream(self._seed, self.number if number is None else number, quantity)
        return int(random.integers(2**SEED_BITS))

    def first_pose(self) -> HandPose:
        """The pose of a sample, or of the first frame of its sequence."""
        poses, random = self.plan.poses, self.stream("poses")
        if poses.kind == "sampler":
            return random_pose(random)
        count = len(poses.poses)
        cycle = poses.order == "cycle"
        first = self.number % count if cycle else int(random.integers(count))
        if poses.kind == "list":
            return poses.poses[first]
        if poses.kind == "around":
            return pose_around(poses.poses[first], self.stream("poses.spread"), poses.spread_deg)
        # Two different ones: the second is any but the first.
        second = (first + 1 + int(random.integers(count - 1))) % count
        share = poses.share.values[0]
        return interpolate_poses(poses.poses[first], poses.poses[second], share)

    def last_pose(self, movement: MovementPlan, first: HandPose) -> HandPose:
        if movement.poses == "stay":
            return first
        if self.plan.poses.kind == "sampler":
            return random_pose(self.stream("movement.pose"))
        return self.one_of("movement.pose", self.plan.poses.poses)

    def pose(self) -> HandPose:
        """The pose of a sample; of a frame of a sequence that in the middle of its sweep."""
        first, movement, radar = self.first_pose(), self.plan.movement, self.plan.radar
        if movement is None:
            return first
        last = self.last_pose(movement, first)
        slots = plan_array(radar.array, radar.every).n_tx * radar.steps
        sweep_s = 1e-6 * (slots - 1) * movement.step_us
        middle_s = self.index % movement.frames / movement.rate_hz + 0.5 * sweep_s
        share = minimum_jerk(min(1.0, middle_s * movement.rate_hz / (movement.frames - 1)))
        if last == first or share in (0.0, 1.0):
            return last if share == 1.0 else first
        return interpolate_poses(first, last, share)

    def side_and_rig(self) -> tuple[str, RigFile | None]:
        hands = self.plan.hands
        sides = ("right", "left") if hands.handedness == "both" else (hands.handedness,)
        side = self.one_of("hands.handedness", sides)
        if not hands.rigs:
            return side, None
        rig = self.one_of("hands.rigs", hands.rigs)
        return (rig.handedness if side == "as it is" else side), rig


def _metres(place: Placement | MovementPlan) -> list[float]:
    return [draw.values[0] / 1e3 for draw in (place.x_mm, place.y_mm, place.z_mm)]


def _radians(place: Placement | MovementPlan) -> list[float]:
    turns = (place.rotation_x_deg, place.rotation_y_deg, place.rotation_z_deg)
    return [float(np.deg2rad(draw.values[0])) for draw in turns]


def _movement(drawn: _Drawn) -> Recipe:
    movement = drawn.plan.movement
    if movement is None:
        return {}
    frame, first = drawn.index % movement.frames, drawn.first_pose()
    return {
        "movement": {
            "sequence": drawn.number,
            "frame": frame,
            "start_s": frame / movement.rate_hz,
            "duration_s": (movement.frames - 1) / movement.rate_hz,
            "poses": [pose_record(pose) for pose in (first, drawn.last_pose(movement, first))],
            "shift_m": _metres(movement),
            "rotation_rad": _radians(movement),
            "order": movement.order,
            "step_s": movement.step_us * 1e-6,
        }
    }


def _hand(drawn: _Drawn) -> Recipe:
    (side, rig), hands = drawn.side_and_rig(), drawn.plan.hands
    if rig is not None:
        return {"handedness": side, "rig": {**rig.model_dump(), "betas": list(rig.betas)}}
    shape = HandShape()
    if hands.shape == "sampled":
        shape = random_shape(drawn.stream("hands.shape"))
    elif hands.shape == "list":
        shape = drawn.one_of("hands.shape", hands.shapes).shape
    edge_m = hands.edge_mm / 1e3
    return {"handedness": side, "shape": shape_record(shape), "edge_length_m": edge_m}


def _surface(plan: Plan) -> Recipe:
    """Return the alphas of all parts; for the physical estimator their materials."""
    if plan.material is not None:
        own, others = plan.material.parts, plan.material.others
        parts = {name: own.get(name, others) for name in PART_NAMES}
        return {"material": {name: material_record(part.least) for name, part in parts.items()}}
    assert plan.alpha is not None, "it has one of the two"
    alphas = {name: plan.alpha.parts.get(name, plan.alpha.others) for name in PART_NAMES}
    return {"alpha": {name: alpha.values[0] for name, alpha in alphas.items()}}


def _simulation(drawn: _Drawn) -> Recipe:
    settings = drawn.plan.simulation.settings(drawn.seed("simulation.seed"))
    return {name: getattr(settings, name) for name in settings.__slots__}


def _image(plan: Plan) -> Recipe:
    image = plan.image
    return {
        **{f"{axis}_m": [v / 1e3 for v in getattr(image, f"{axis}_mm")] for axis in "xyz"},
        "step_m": [step / 1e3 for step in image.step_mm],
        **{name: getattr(image, name) for name in IMAGING},
    }


def _impairments(drawn: _Drawn) -> Recipe:
    given = drawn.plan.impairments
    channels, seed = None, "impairments.channels.seed"
    if given.channels is not None:
        own = given.channels
        channels = {
            # With one instrument for all, the draw of sample 0.
            "seed": drawn.seed(seed, 0 if own.per == "dataset" else None),
            "gain_db": own.gain_db,
            "phase_rad": float(np.deg2rad(own.phase_deg)),
            "delay_s": 1e-12 * own.delay_ps,
            "dead_tx": list(own.dead_tx),
            "dead_rx": list(own.dead_rx),
        }
    return {
        "seed": drawn.seed("impairments.seed"),
        "snr_db": None if given.snr_db is None else given.snr_db.values[0],
        "coupling_db": None if given.coupling_db is None else given.coupling_db.values[0],
        "coupling_delay_s": 1e-12 * given.coupling_delay_ps.values[0],
        "iq_gain_db": given.iq_gain_db.values[0],
        "iq_phase_rad": float(np.deg2rad(given.iq_phase_deg.values[0])),
        "adc_bits": given.adc_bits,
        "channels": channels,
        "walls": [
            {
                "point_m": [value / 1e3 for value in wall.point_mm],
                "normal": list(wall.normal),
                "amplitude": wall.amplitude,
            }
            for wall in given.walls
        ],
    }

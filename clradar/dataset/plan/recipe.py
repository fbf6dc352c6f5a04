"""The recipe of one sample: a function of the plan and the sample's number alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.dataset.plan.draws import Draw, stream
from clradar.dataset.plan.hand_json import pose_record, shape_record
from clradar.dataset.plan.hands import Hands, MovementPlan, Poses, RigFile
from clradar.dataset.plan.materials import PartMaterial
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.radar import ChannelErrors, Impairments, plan_array
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
    # All frames of a sequence have the draws of the sequence.
    number = _number(plan, index)
    drawn = _Drawn(plan.seed, number)
    pose = _pose(plan.poses, drawn, number)
    movement = {} if plan.movement is None else _movement(plan, plan.movement, drawn, pose, index)
    return {
        "version": VERSION if plan.movement is None else MOVING_VERSION,
        "sample": index,
        "pose": pose_record(_pose_of_sample(plan, index)),
        **movement,
        "hand": _hand(plan.hands, drawn),
        "placement": _placement(plan, drawn),
        **_surface(plan, drawn),
        "radar": {
            "array": plan.radar.array,
            "every": plan.radar.every,
            "start_hz": plan.radar.start_ghz * 1e9,
            "stop_hz": plan.radar.stop_ghz * 1e9,
            "steps": plan.radar.steps,
        },
        "simulation": _simulation(plan, drawn),
        "impairments": _impairments(plan.impairments, plan, drawn),
        "image": _image(plan) if plan.keeps_images else None,
        "products": list(plan.output.products),
    }


def pose_and_hand(plan: Plan, index: int) -> tuple[str, str]:
    """Return the name of the pose and the handedness of sample `index`, as its recipe has them."""
    drawn = _Drawn(plan.seed, _number(plan, index))
    return _pose_of_sample(plan, index).name, _side_and_rig(plan.hands, drawn)[0]


def _number(plan: Plan, index: int) -> int:
    """What a sample's draws are numbered by: itself, or its sequence."""
    return index if plan.movement is None else index // plan.movement.frames


def _pose_of_sample(plan: Plan, index: int) -> HandPose:
    """The pose of a sample; of a frame of a sequence that in the middle of its sweep."""
    number = _number(plan, index)
    drawn = _Drawn(plan.seed, number)
    pose = _pose(plan.poses, drawn, number)
    if plan.movement is None:
        return pose
    movement, radar = plan.movement, plan.radar
    last = _last_pose(plan, movement, drawn, pose)
    slots = plan_array(radar.array, radar.every).n_tx * radar.steps
    middle_s = index % movement.frames / movement.rate_hz + 0.5e-6 * (slots - 1) * movement.step_us
    share = minimum_jerk(min(1.0, middle_s * movement.rate_hz / (movement.frames - 1)))
    if last == pose or share in (0.0, 1.0):
        return last if share == 1.0 else pose
    return interpolate_poses(pose, last, share)


def _last_pose(plan: Plan, movement: MovementPlan, drawn: _Drawn, first: HandPose) -> HandPose:
    if movement.poses == "stay":
        return first
    random = drawn.stream("movement.pose")
    if plan.poses.kind == "sampler":
        return random_pose(random)
    poses = plan.poses.poses
    return poses[int(random.integers(len(poses)))]


def _movement(
    plan: Plan, movement: MovementPlan, drawn: _Drawn, first: HandPose, index: int
) -> Recipe:
    def three(keys: tuple[str, str, str]) -> list[float]:
        return [drawn.number(f"movement.{key}", getattr(movement, key)) for key in keys]

    shift_mm = three(("x_mm", "y_mm", "z_mm"))
    turn_deg = three(("rotation_x_deg", "rotation_y_deg", "rotation_z_deg"))
    frame = index % movement.frames
    last = _last_pose(plan, movement, drawn, first)
    return {
        "movement": {
            "sequence": index // movement.frames,
            "frame": frame,
            "start_s": frame / movement.rate_hz,
            "duration_s": (movement.frames - 1) / movement.rate_hz,
            "poses": [pose_record(first), pose_record(last)],
            "shift_m": [value / 1e3 for value in shift_mm],
            "rotation_rad": [float(np.deg2rad(value)) for value in turn_deg],
            "order": movement.order,
            "step_s": movement.step_us * 1e-6,
        }
    }


class _Drawn:
    """The draws of one sample."""

    def __init__(self, seed: int, index: int) -> None:
        self._seed, self._index = seed, index

    def stream(self, quantity: str) -> np.random.Generator:
        return stream(self._seed, self._index, quantity)

    def number(self, quantity: str, draw: Draw) -> float:
        return draw.draw(self.stream(quantity))

    def one_of(self, quantity: str, choices: tuple[Any, ...]) -> Any:
        return choices[int(self.stream(quantity).integers(len(choices)))]

    def seed(self, quantity: str) -> int:
        return int(self.stream(quantity).integers(2**SEED_BITS))


def _pose(poses: Poses, drawn: _Drawn, index: int) -> HandPose:
    if poses.kind == "sampler":
        return random_pose(drawn.stream("poses"))
    count = len(poses.poses)
    random = drawn.stream("poses")
    first = index % count if poses.order == "cycle" else int(random.integers(count))
    if poses.kind == "list":
        return poses.poses[first]
    if poses.kind == "around":
        return pose_around(poses.poses[first], drawn.stream("poses.spread"), poses.spread_deg)
    # Two different ones: the second is any but the first.
    second = (first + 1 + int(random.integers(count - 1))) % count
    share = drawn.number("poses.share", poses.share)
    return interpolate_poses(poses.poses[first], poses.poses[second], share)


def _side_and_rig(hands: Hands, drawn: _Drawn) -> tuple[str, RigFile | None]:
    sides = ("right", "left") if hands.handedness == "both" else (hands.handedness,)
    side = drawn.one_of("hands.handedness", sides)
    if not hands.rigs:
        return side, None
    rig = drawn.one_of("hands.rigs", hands.rigs)
    return (rig.handedness if side == "as it is" else side), rig


def _hand(hands: Hands, drawn: _Drawn) -> Recipe:
    side, rig = _side_and_rig(hands, drawn)
    if rig is not None:
        return {"handedness": side, "rig": {**rig.model_dump(), "betas": list(rig.betas)}}
    shape = HandShape()
    if hands.shape == "sampled":
        shape = random_shape(drawn.stream("hands.shape"))
    elif hands.shape == "list":
        shape = drawn.one_of("hands.shape", hands.shapes).shape
    return {
        "handedness": side,
        "shape": shape_record(shape),
        "edge_length_m": hands.edge_mm / 1e3,
    }


def _placement(plan: Plan, drawn: _Drawn) -> Recipe:
    def three(keys: tuple[str, str, str]) -> list[float]:
        return [drawn.number(f"placement.{key}", getattr(plan.placement, key)) for key in keys]

    centre_mm = three(("x_mm", "y_mm", "z_mm"))
    angles_deg = three(("rotation_x_deg", "rotation_y_deg", "rotation_z_deg"))
    return {
        "center_m": [value / 1e3 for value in centre_mm],
        "rotation_rad": [float(np.deg2rad(value)) for value in angles_deg],
    }


def _surface(plan: Plan, drawn: _Drawn) -> Recipe:
    """Return the alphas of all parts; for the physical estimator their materials."""
    if plan.material is not None:
        others = _material(plan.material.others, "others", drawn)
        parts = {n: _material(own, n, drawn) for n, own in plan.material.parts.items()}
        return {"material": {name: parts.get(name, others) for name in PART_NAMES}}
    assert plan.alpha is not None, "it has one of the two"
    alpha = drawn.number("alpha.others", plan.alpha.others)
    own = {name: drawn.number(f"alpha.{name}", draw) for name, draw in plan.alpha.parts.items()}
    return {"alpha": {name: own.get(name, alpha) for name in PART_NAMES}}


def _material(part: PartMaterial, name: str, drawn: _Drawn) -> Recipe:
    lengths_mm = {k: drawn.number(f"material.{name}.{k}", draw) for k, draw in part.draws.items()}
    return material_record(part.drawn(lengths_mm))


def _simulation(plan: Plan, drawn: _Drawn) -> Recipe:
    settings = plan.simulation.settings(drawn.seed("simulation.seed"))
    return {name: getattr(settings, name) for name in settings.__slots__}


def _image(plan: Plan) -> Recipe:
    image = plan.image
    return {
        **{f"{axis}_m": [v / 1e3 for v in getattr(image, f"{axis}_mm")] for axis in "xyz"},
        "step_m": [step / 1e3 for step in image.step_mm],
        "method": image.method,
        "window": image.window,
        "tolerance_db": image.tolerance_db,
        "dynamic_range_db": image.dynamic_range_db,
    }


def _impairments(impairments: Impairments, plan: Plan, drawn: _Drawn) -> Recipe | None:
    if not impairments.any:
        return None

    def level(key: str) -> float | None:
        draw = getattr(impairments, key)
        return None if draw is None else drawn.number(f"impairments.{key}", draw)

    channels = impairments.channels
    return {
        "seed": drawn.seed("impairments.seed"),
        "snr_db": level("snr_db"),
        "coupling_db": level("coupling_db"),
        "coupling_delay_s": 1e-12
        * drawn.number("impairments.coupling_delay_ps", impairments.coupling_delay_ps),
        "iq_gain_db": level("iq_gain_db"),
        "iq_phase_rad": float(
            np.deg2rad(drawn.number("impairments.iq_phase_deg", impairments.iq_phase_deg))
        ),
        "adc_bits": impairments.adc_bits,
        "channels": None if channels is None else _channels(channels, plan, drawn),
        "walls": [
            {
                "point_m": [value / 1e3 for value in wall.point_mm],
                "normal": list(wall.normal),
                "amplitude": wall.amplitude,
            }
            for wall in impairments.walls
        ],
    }


def _channels(channels: ChannelErrors, plan: Plan, drawn: _Drawn) -> Recipe:
    seed = drawn.seed("impairments.channels.seed")
    if channels.per == "dataset":  # one instrument: the draw of sample 0 for all
        seed = _Drawn(plan.seed, 0).seed("impairments.channels.seed")
    return {
        "seed": seed,
        "gain_db": channels.gain_db,
        "phase_rad": float(np.deg2rad(channels.phase_deg)),
        "delay_s": 1e-12 * channels.delay_ps,
        "dead_tx": list(channels.dead_tx),
        "dead_rx": list(channels.dead_rx),
    }

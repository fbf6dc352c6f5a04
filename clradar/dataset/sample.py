"""Samples: from a plan to its recipe, and from that to posed hand, simulation and image."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from clradar.backproject import backproject
from clradar.dataset.plan.draws import Draw, fixed, in_si, stream
from clradar.dataset.plan.hands import Hands, MovementPlan, Poses, RigFile, ShapeTable
from clradar.dataset.plan.plan import Plan, plan_record
from clradar.errors import ModelError
from clradar.files.failures import clean
from clradar.files.records import record_of
from clradar.hand import (
    HandMesh,
    HandPose,
    hand_mesh,
    interpolate_poses,
    pose_around,
    random_pose,
    random_shape,
)
from clradar.hand.pose import minimum_jerk
from clradar.impairments.channel_errors import draw_channels
from clradar.impairments.impair import Wall, impair, room_capture
from clradar.model import Capture, Scene, checks
from clradar.motion.hands import MovingHand
from clradar.motion.instants import SweepTiming
from clradar.motion.rigid import RigidMotion
from clradar.motion.sweep import MovingScene, simulate_moving
from clradar.opencl import Device
from clradar.simulation import simulate

RECIPE_VERSION = 3
SEED_BITS = 63


def recipe(plan: Plan, index: int) -> dict[str, Any]:
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
    version, sample = content.pop("version", RECIPE_VERSION), content.pop("sample", 0)
    if version != RECIPE_VERSION:
        older = "older ones follow from their plan: clradar.dataset.recipe(plan, sample)"
        checks.fail("recipe", f"version {RECIPE_VERSION}", f"{version!r}; {older}")
    plan = record_of(content, Plan, "recipe", error=ModelError)
    return SamplePlan(plan, checks.whole("recipe: sample", sample, 0))


class SamplePlan:
    """One sample: its number, and its `plan`, in which a number stands in place of every draw.

    All frames of a sequence have the draws of the sequence, and its `number`.
    """

    def __init__(self, plan: Plan, sample: int) -> None:
        self.sample = self.number = sample
        self.frame, self.start_s = 0, 0.0  # in the sequence, when the frame begins
        if plan.movement is not None:
            self.number, self.frame = divmod(sample, plan.movement.frames)
            self.start_s = self.frame / plan.movement.rate_hz
        self._seed = plan.seed
        drawn: Plan = self._numbers(plan, "")
        self.first = first = self._first_pose(drawn.poses)
        more: dict[str, Any] = {"hands": self._hands(drawn.hands)}
        if drawn.movement is not None:
            last = self._last_pose(drawn.movement, drawn.poses, first)
            more["movement"] = drawn.movement.model_copy(update={"last": last})
        self.plan: Plan = drawn.model_copy(update={**more, "poses": Poses(resolved=(first,))})

    def _numbers(self, node: Any, path: str) -> Any:
        """A table with a number in place of every draw, and of a seed that is not given."""
        if isinstance(node, Draw):
            return node if node.kind == "fixed" else fixed(node.draw(self._stream(path)))
        if not isinstance(node, BaseModel):
            return node
        above = f"{path}." if path else ""
        values = {n: self._numbers(getattr(node, n), above + n) for n in type(node).model_fields}
        if values.get("seed", 0) is None and getattr(node, "any", True):
            # One instrument for all has the draw of sample 0.
            number = 0 if values.get("per") == "dataset" else self.number
            random = stream(self._seed, number, f"{above}seed")
            values["seed"] = int(random.integers(2**SEED_BITS))
        return node.model_copy(update=values)

    def _stream(self, quantity: str) -> np.random.Generator:
        return stream(self._seed, self.number, quantity)

    def _one_of(self, quantity: str, choices: tuple[Any, ...]) -> Any:
        return choices[int(self._stream(quantity).integers(len(choices)))]

    def _first_pose(self, poses: Poses) -> HandPose:
        """The pose of a sample, or of the first frame of its sequence."""
        random = self._stream("poses")
        if poses.kind == "sampler":
            return random_pose(random)
        count = len(poses.resolved)
        cycle = poses.order == "cycle"
        first = self.number % count if cycle else int(random.integers(count))
        pose = poses.resolved[first]
        if poses.spread_deg is not None:
            return pose_around(pose, self._stream("poses.spread"), poses.spread_deg)
        if poses.share is None:
            return pose
        # Two different ones: the second is any but the first.
        second = (first + 1 + int(random.integers(count - 1))) % count
        return interpolate_poses(pose, poses.resolved[second], float(poses.share))

    def _last_pose(self, movement: MovementPlan, poses: Poses, first: HandPose) -> HandPose:
        if movement.last is not None:
            return movement.last
        if movement.poses == "stay":
            return first
        if poses.kind == "sampler":
            return random_pose(self._stream("movement.pose"))
        return self._one_of("movement.pose", poses.resolved)

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
    def record(self) -> dict[str, Any]:
        """The recipe."""
        return {"version": RECIPE_VERSION, "sample": self.sample, **plan_record(self.plan)}

    @property
    def middle_s(self) -> float:
        """The middle of the sweep of its frame, in its sequence."""
        slots = self.plan.radar.antennas.n_tx * self.plan.radar.steps
        step_us = 0.0 if self.plan.movement is None else self.plan.movement.step_us
        return self.start_s + 0.5e-6 * (slots - 1) * step_us

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


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One sample of a data set.

    Attributes
    ----------
    recipe : mapping
        As of `clradar.dataset.recipe`.
    arrays : mapping of str to ndarray
        Its products; a mesh is "mesh_vertices", "mesh_faces" and "mesh_part".
    """

    recipe: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]


def make_sample(
    recipe: Mapping[str, Any] | str | bytes,
    device: Device | str | None = None,
    *,
    rigs: str | os.PathLike[str] = "",
) -> Sample:
    """Make the sample of a recipe.

    Its bits depend on the device and its driver, not on earlier samples or the number of threads.

    Parameters
    ----------
    recipe : mapping, or its JSON text
        As of `clradar.dataset.recipe`, or as it is stored with a sample.
    rigs : path-like
        The folder that the names of rig files are relative to; the current one by default.

    Examples
    --------
    The same hand somewhere else: what is changed in a recipe may be any value of a plan.

    >>> from clradar.dataset import make_sample, read_plan, recipe
    >>> there = recipe(read_plan("plan.toml"), 0)
    >>> beside = {**there, "placement": {**there["placement"], "x_mm": 20.0}}
    >>> one, other = (make_sample(r).arrays["joints"] for r in (there, beside))
    >>> (1e3 * (other - one)[0]).round(6).tolist()
    [20.0, 0.0, 0.0]
    """
    drawn = read_recipe(recipe)
    plan, products = drawn.plan, drawn.plan.output.products
    arrays: dict[str, np.ndarray] = {}
    hand = None if plan.movement is None else moving_hand(drawn, device)
    mesh = placed_hand(drawn, device, rigs) if hand is None else hand.mesh(drawn.middle_s)
    if "joints" in products:
        arrays["joints"] = mesh.joints_m
    if "mesh" in products:
        arrays["mesh_vertices"] = mesh.vertices_m.astype(np.float32)
        arrays["mesh_faces"] = mesh.faces
        arrays["mesh_part"] = mesh.part.astype(np.uint8)
    if not plan.needs_capture:
        return Sample(drawn.record, arrays)
    capture = recorded_capture(drawn, hand or scene_of(mesh, drawn), device)
    if "capture" in products:
        arrays["capture"] = capture.data
    if plan.keeps_images:
        image = plan.image
        volume = backproject(
            capture, image.grid, method=image.method, window=image.window,
            tolerance_db=image.tolerance_db, check_grid=False, device=device,
        )  # fmt: skip
        images: dict[str, Callable[[], np.ndarray]] = {
            "volume": lambda: volume.data,
            "max_projection": volume.max_projection,
            "depth_map": lambda: volume.depth_map(image.dynamic_range_db).depth_m.astype("f4"),
        }
        arrays |= {name: make() for name, make in images.items() if name in products}
    return Sample(drawn.record, arrays)


def placed_hand(
    drawn: SamplePlan, device: Device | str | None = None, rigs: str | os.PathLike[str] = ""
) -> HandMesh:
    """Return the posed hand in the antenna frame, metres."""
    hands, place = drawn.plan.hands, drawn.plan.placement
    if hands.rigs:
        rig = _rig(hands.rigs[0], os.path.abspath(rigs))
        mesh = rig.posed(drawn.pose, center_m=(0.0, 0.0, 0.0))
        if rig.handedness != hands.handedness:  # a hand of the other side is mirrored
            mesh = mesh.moved(np.diag([-1.0, 1.0, 1.0]), np.zeros(3))
    else:
        mesh = hand_mesh(
            drawn.pose, edge_length_m=hands.edge_mm / 1e3, handedness=hands.handedness,
            center_m=(0.0, 0.0, 0.0), shape=hands.shapes[0].shape, device=device,
        )  # fmt: skip
    return mesh.moved(rotation(place.radians), np.asarray(place.metres))


def moving_hand(drawn: SamplePlan, device: Device | str | None = None) -> MovingHand:
    """Return the hand of the sequence that a sample is a frame of."""
    from scipy.spatial.transform import Rotation

    hands, place = drawn.plan.hands, drawn.plan.placement
    movement: Any = drawn.plan.movement
    begin = Rotation.from_matrix(rotation(place.radians))
    end = Rotation.from_matrix(rotation(movement.radians)) * begin
    times_s = (0.0, (movement.frames - 1) / movement.rate_hz)
    motion = RigidMotion(
        times_s, [(0.0, 0.0, 0.0), movement.metres], [begin.as_rotvec(), end.as_rotvec()],
        about_m=place.metres, profile="smooth",
    )  # fmt: skip
    return MovingHand(
        times_s, [drawn.first, movement.last], motion=motion, center_m=place.metres,
        shape=hands.shapes[0].shape, edge_length_m=hands.edge_mm / 1e3,
        handedness=hands.handedness, device=device,
    )  # fmt: skip


@lru_cache(maxsize=4)
def _rig(record: RigFile, folder: str) -> Any:
    record.check(Path(folder))
    return record.read(Path(folder))


def rotation(angles_rad: Any) -> np.ndarray:
    """Return the rotation matrix (3, 3) about the fixed axes x, then y, then z: Rz Ry Rx."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def scene_of(mesh: HandMesh | Scene, drawn: SamplePlan) -> Scene:
    """Return the scene of a hand with the alphas of its parts, or their materials."""
    alpha, material = drawn.plan.alpha, drawn.plan.material
    scene = Scene(
        mesh.vertices_m, mesh.faces, part=mesh.part, part_names=mesh.part_names,
        normals=mesh.normals, texture_m=mesh.texture_m,
    )  # fmt: skip
    if material is not None:
        materials = material.of_parts
        return scene.with_material({name: materials[name] for name in scene.part_names})
    alphas = {} if alpha is None else alpha.of_parts
    return scene.with_alpha({name: alphas[name] for name in scene.part_names})


def recorded_capture(drawn: SamplePlan, scene: Any, device: Device | str | None) -> Capture:
    """Return the simulated capture of a scene or moving hand, with the plan's impairments."""
    plan = drawn.plan
    array, waveform = plan.radar.antennas, plan.radar.waveform
    settings, movement = plan.simulation.settings(), plan.movement
    if movement is not None:
        timing = SweepTiming.in_order(
            array.n_tx, waveform.n_freq, step_s=movement.step_us * 1e-6, order=movement.order
        )
        moving = MovingScene([scene], lambda own: scene_of(own, drawn))
        capture = simulate_moving(
            moving, array, waveform, timing=timing, start_s=drawn.start_s, settings=settings,
            device=device,
        )  # fmt: skip
    else:
        capture = simulate(scene, array, waveform, settings=settings, device=device)
    given = plan.impairments
    if not given.any:
        return capture
    channels = room = None
    if given.channels is not None:
        channels = draw_channels(array, waveform, **in_si(given.channels, "per"))
    if given.walls:
        room = room_capture(array, waveform, [Wall(**in_si(wall)) for wall in given.walls])
    numbers = in_si(given, "channels", "walls")
    return impair(capture, channels=channels, room=room, frame=drawn.frame, **numbers)

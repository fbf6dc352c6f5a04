"""From a recipe to a sample: posed hand, simulation, impairments, image formation."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from clradar.backproject import backproject
from clradar.dataset.plan.hands import RigFile
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import SamplePlan, read_recipe
from clradar.files.failures import clean, shown
from clradar.files.hashing import sha256_of
from clradar.files.meshes.gltf_document import files_of
from clradar.hand import HandMesh, hand_mesh
from clradar.impairments.channel_errors import draw_channels
from clradar.impairments.impair import Wall, impair, room_capture
from clradar.model import Capture, Scene, checks
from clradar.motion.bodies import MovingScene
from clradar.motion.hands import MovingHand
from clradar.motion.rigid import RigidMotion
from clradar.motion.sweep import simulate_moving
from clradar.motion.timing import SweepTiming
from clradar.opencl import Device
from clradar.simulation import simulate


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
        if "volume" in products:
            arrays["volume"] = volume.data
        if "max_projection" in products:
            arrays["max_projection"] = volume.max_projection()
        if "depth_map" in products:
            depth = volume.depth_map(image.dynamic_range_db)
            arrays["depth_map"] = depth.depth_m.astype(np.float32)
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

    hands, place, movement = drawn.plan.hands, drawn.plan.placement, drawn.plan.movement
    assert movement is not None
    assert movement.last is not None
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
    check_rigs([record], Path(folder))
    return record.read(Path(folder))


def check_rigs(records: Sequence[RigFile], folder: Path) -> None:
    """Raise `ModelError` unless the files of rigs are those of the plan."""
    known = {folder / own.file: own.sha256 for own in records}
    known |= {folder / own.mapping: str(own.mapping_sha256) for own in records if own.mapping}
    for path, sha256 in known.items():
        try:
            if sha256_of(*files_of(path)) == sha256:
                continue
            got = "another"
        except FileNotFoundError:
            got = "nothing there"
        except (OSError, ValueError) as error:
            got = f"none that can be read: {clean(error)}"
        checks.fail(shown(path), f"the file of the plan (SHA-256 {sha256})", got)


def rotation(angles_rad: Any) -> np.ndarray:
    """Return the rotation matrix (3, 3) about the fixed axes x, then y, then z: Rz Ry Rx."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def scene_of(mesh: HandMesh, drawn: SamplePlan) -> Scene:
    """Return the scene of a hand with the alphas of its parts, or their materials."""
    scene = Scene(
        mesh.vertices_m, mesh.faces, part=mesh.part, part_names=mesh.part_names,
        normals=mesh.normals, texture_m=mesh.texture_m,
    )  # fmt: skip
    return _with_surface(scene, drawn.plan)


def _with_surface(scene: Scene, plan: Plan) -> Scene:
    if plan.material is not None:
        materials = plan.material.of_parts
        return scene.with_material({name: materials[name] for name in scene.part_names})
    assert plan.alpha is not None, "it has one of the two"
    alphas = plan.alpha.of_parts
    return scene.with_alpha({name: alphas[name] for name in scene.part_names})


def recorded_capture(
    drawn: SamplePlan, scene: Scene | MovingHand, device: Device | str | None
) -> Capture:
    """Return the simulated capture of a scene, with the impairments of the plan."""
    plan = drawn.plan
    array, waveform = plan.radar.antennas, plan.radar.waveform
    settings, movement = plan.simulation.settings(), plan.movement
    if isinstance(scene, MovingHand):
        assert movement is not None
        timing = SweepTiming.in_order(
            array.n_tx, waveform.n_freq, step_s=movement.step_us * 1e-6, order=movement.order
        )
        moving = MovingScene([scene], lambda own: _with_surface(own, plan))
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
    if (own := given.channels) is not None:
        channels = draw_channels(
            array, waveform, seed=own.seed or 0, gain_db=own.gain_db,
            phase_rad=float(np.deg2rad(own.phase_deg)), delay_s=1e-12 * own.delay_ps,
            dead_tx=own.dead_tx, dead_rx=own.dead_rx,
        )  # fmt: skip
    if given.walls:
        walls = [
            Wall(np.array(wall.point_mm) / 1e3, np.array(wall.normal), wall.amplitude)
            for wall in given.walls
        ]
        room = room_capture(array, waveform, walls)
    return impair(
        capture, seed=given.seed or 0, channels=channels, room=room, frame=drawn.frame,
        snr_db=None if given.snr_db is None else float(given.snr_db),
        coupling_db=None if given.coupling_db is None else float(given.coupling_db),
        coupling_delay_s=1e-12 * float(given.coupling_delay_ps),
        iq_gain_db=float(given.iq_gain_db),
        iq_phase_rad=float(np.deg2rad(float(given.iq_phase_deg))),
        adc_bits=given.adc_bits,
    )  # fmt: skip

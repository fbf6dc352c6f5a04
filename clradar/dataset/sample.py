"""From a recipe to a sample: posed hand, simulation, impairments, image formation."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from clradar.backproject import backproject
from clradar.dataset.plan.hand_json import pose_of, shape_of
from clradar.dataset.plan.radar import plan_array
from clradar.dataset.plan.recipe import EARLIER_SETTINGS
from clradar.errors import ModelError
from clradar.files.failures import clean, shown
from clradar.files.hashing import sha256_of
from clradar.hand import HandMesh, HandPose, hand_mesh
from clradar.impairments.channel_errors import draw_channels
from clradar.impairments.environment import Wall, room_capture
from clradar.impairments.impair import impair
from clradar.model import AntennaArray, Capture, Scene, VoxelGrid, Waveform
from clradar.model.material_file import material_of
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
        As `clradar.dataset.recipe` returns it.
    arrays : mapping of str to ndarray
        Its products; a mesh is "mesh_vertices", "mesh_faces" and "mesh_part".

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import make_sample, read_plan, recipe
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> plan = read_plan("plan.toml")
    >>> sample = make_sample(recipe(plan, 1))
    >>> sample.recipe["pose"]["name"], sample.arrays["joints"].shape
    ('B', (25, 3))
    """

    recipe: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]


Folders = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""One folder, or several of which the first with a file of that name and content counts."""


def make_sample(
    recipe: Mapping[str, Any] | str | bytes,
    device: Device | str | None = None,
    *,
    rigs: Folders = "",
) -> Sample:
    """Make the sample of a recipe.

    Parameters
    ----------
    recipe : mapping, or its JSON text
        As `clradar.dataset.recipe` returns it, or as it is stored with a sample
        (``open_dataset(folder).recipe.values[0]``).
    device : Device, str or None
        See `clradar.open_device`.
    rigs : path-like, or a sequence of them
        The folder that the names of rig files are relative to; the current one by default. Of
        several, the first with the file counts.

    Returns
    -------
    Sample
        The products that the recipe lists. Their bits depend on the device and its driver, not on
        earlier samples or the number of threads.

    Raises
    ------
    ModelError
        It is no recipe, lacks a key, or a rig's file is not that of the plan.
    DeviceError
        There is no such device, or it fails.

    Examples
    --------
    The same sample with and without noise 20 dB below the signal.

    >>> from pathlib import Path
    >>> import numpy as np
    >>> from clradar.dataset import make_sample, read_plan, recipe
    >>> _ = Path("plan.toml").write_text('''
    ... samples = 1
    ... poses.names = ["A"]
    ... hands.edge_mm = 4
    ... radar = { every = 24, steps = 4 }
    ... simulation.samples_per_mm2 = 0.05
    ... impairments.snr_db = 20
    ... output.products = ["capture"]
    ... ''')
    >>> noisy = recipe(read_plan("plan.toml"), 0)
    >>> clean = {**noisy, "impairments": None}
    >>> with_noise, without = (make_sample(r).arrays["capture"] for r in (noisy, clean))
    >>> ratio = np.linalg.norm(without) / np.linalg.norm(with_noise - without)
    >>> round(20 * np.log10(float(ratio)))
    20
    """
    recipe = _recipe(recipe)
    try:
        return _made(recipe, device, rigs)
    except KeyError as error:
        raise ModelError(
            f"recipe: expected all keys that clradar.dataset.recipe gives, got no {error}"
        ) from error


def _recipe(given: Mapping[str, Any] | str | bytes) -> Mapping[str, Any]:
    found: Any = given
    if isinstance(given, str | bytes):
        try:
            found = json.loads(given)
        except ValueError as error:
            raise ModelError(
                f"recipe: expected JSON text of a recipe, got no JSON: {clean(error)}"
            ) from error
    if not isinstance(found, Mapping):
        raise ModelError(
            f"recipe: expected a mapping, or its JSON text, got {type(found).__name__}"
        )
    return found


def _made(recipe: Mapping[str, Any], device: Device | str | None, rigs: Folders) -> Sample:
    products = recipe["products"]
    arrays: dict[str, np.ndarray] = {}
    hand = moving_hand(recipe, device) if "movement" in recipe else None
    mesh = placed_hand(recipe, device, rigs) if hand is None else _in_the_middle(hand, recipe)
    if "joints" in products:
        arrays["joints"] = mesh.joints_m
    if "mesh" in products:
        arrays["mesh_vertices"] = mesh.vertices_m.astype(np.float32)
        arrays["mesh_faces"] = mesh.faces
        arrays["mesh_part"] = mesh.part.astype(np.uint8)
    image = recipe.get("image")
    if image is None and "capture" not in products:
        return Sample(recipe, arrays)
    capture = recorded_capture(recipe, hand or scene_of(mesh, recipe), device)
    if "capture" in products:
        arrays["capture"] = capture.data
    if image is not None:
        volume = backproject(
            capture,
            recipe_grid(recipe),
            method=image["method"],
            window=image["window"],
            tolerance_db=image["tolerance_db"],
            check_grid=False,
            device=device,
        )
        if "volume" in products:
            arrays["volume"] = volume.data
        if "max_projection" in products:
            arrays["max_projection"] = volume.max_projection()
        if "depth_map" in products:
            depth = volume.depth_map(image["dynamic_range_db"])
            arrays["depth_map"] = depth.depth_m.astype(np.float32)
    return Sample(recipe, arrays)


def placed_hand(
    recipe: Mapping[str, Any], device: Device | str | None = None, rigs: Folders = ""
) -> HandMesh:
    """Return the posed hand in the antenna frame, metres."""
    hand, place = recipe["hand"], recipe["placement"]
    pose = pose_of(recipe["pose"])
    origin_m = (0.0, 0.0, 0.0)
    if "rig" in hand:
        mesh = posed_rig(hand["rig"], pose, hand["handedness"], rigs)
    else:
        mesh = hand_mesh(
            pose,
            edge_length_m=hand["edge_length_m"],
            handedness=hand["handedness"],
            center_m=origin_m,
            shape=shape_of(hand["shape"]),
            device=device,
        )
    matrix = rotation(place["rotation_rad"])
    centre_m = np.asarray(place["center_m"])
    return mesh.moved(matrix, centre_m)


def moving_hand(recipe: Mapping[str, Any], device: Device | str | None = None) -> MovingHand:
    """Return the hand of the sequence that a sample is a frame of."""
    from scipy.spatial.transform import Rotation

    hand, place, movement = recipe["hand"], recipe["placement"], recipe["movement"]
    first, last = (pose_of(record) for record in movement["poses"])
    begin = Rotation.from_matrix(rotation(place["rotation_rad"]))
    end = Rotation.from_matrix(rotation(movement["rotation_rad"])) * begin
    times_s = (0.0, movement["duration_s"])
    motion = RigidMotion(
        times_s,
        [(0.0, 0.0, 0.0), movement["shift_m"]],
        [begin.as_rotvec(), end.as_rotvec()],
        about_m=place["center_m"],
        profile="smooth",
    )
    return MovingHand(
        times_s,
        [first, last],
        motion=motion,
        center_m=place["center_m"],
        shape=shape_of(hand["shape"]),
        edge_length_m=hand["edge_length_m"],
        handedness=hand["handedness"],
        device=device,
    )


def _in_the_middle(hand: MovingHand, recipe: Mapping[str, Any]) -> HandMesh:
    """The hand in the middle of a frame's sweep."""
    timing, start_s = _timing(recipe), recipe["movement"]["start_s"]
    return hand.mesh(0.5 * ((timing.begin_s + start_s) + (timing.end_s + start_s)))


def _timing(recipe: Mapping[str, Any]) -> SweepTiming:
    array, waveform = recipe_radar(recipe)
    movement = recipe["movement"]
    return SweepTiming.in_order(
        array.n_tx, waveform.n_freq, step_s=movement["step_s"], order=movement["order"]
    )


def posed_rig(
    record: Mapping[str, Any], pose: HandPose, handedness: str, rigs: Folders = ""
) -> HandMesh:
    """Return a rig's hand in a pose about the origin; a hand of the other side is mirrored."""
    folders = (rigs,) if isinstance(rigs, str | os.PathLike) else rigs
    rig = _rig(json.dumps(record), tuple(os.path.abspath(folder) for folder in folders))
    mesh = rig.posed(pose, center_m=(0.0, 0.0, 0.0))
    if rig.handedness == handedness:
        return mesh
    return mesh.moved(np.diag([-1.0, 1.0, 1.0]), np.zeros(3))


@lru_cache(maxsize=4)
def _rig(text: str, folders: tuple[str, ...]) -> Any:
    from clradar.rigs import read_rig

    record = found_rig(json.loads(text), folders)
    return read_rig(
        record["file"],
        mapping=record["mapping"],
        unit=record["unit"],
        handedness=record["handedness"],
        betas=record["betas"] or None,
    )


def found_rig(record: Mapping[str, Any], folders: Sequence[str | Path]) -> dict[str, Any]:
    """Return the record of a rig with the paths of its files.

    Raises
    ------
    ModelError
        They are missing, or not those of the plan.
    """
    found = dict(record)
    for key in ("file", "mapping"):
        if record[key] is not None:
            wanted = record["sha256" if key == "file" else "mapping_sha256"]
            found[key] = _path_of(record[key], wanted, folders)
    return found


def _path_of(name: str, sha256: str, folders: Sequence[str | Path]) -> str:
    """Return the path of the file of this name and content."""
    paths = list(dict.fromkeys(os.path.join(folder, name) for folder in folders))
    got = "nothing there"
    for path in paths:
        try:
            if sha256_of(Path(path)) == sha256:
                return path
            got = "another"
        except FileNotFoundError:
            pass
        except (OSError, ValueError) as error:
            got = f"none that can be read: {clean(error)}"
    looked = " or ".join(map(shown, paths))
    raise ModelError(f"{looked}: expected the file of the plan (SHA-256 {sha256}), got {got}")


def rotation(angles_rad: Any) -> np.ndarray:
    """Return the rotation matrix (3, 3) about the fixed axes x, then y, then z: Rz Ry Rx."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def scene_of(mesh: HandMesh, recipe: Mapping[str, Any]) -> Scene:
    """Return the scene of a hand with the alphas of its parts, or their materials."""
    scene = Scene(
        mesh.vertices_m, mesh.faces, part=mesh.part, part_names=mesh.part_names,
        normals=mesh.normals, texture_m=mesh.texture_m,
    )  # fmt: skip
    return _with_surface(scene, recipe)


def _with_surface(scene: Scene, recipe: Mapping[str, Any]) -> Scene:
    if "material" in recipe:
        own = {name: material_of(recipe["material"][name]) for name in scene.part_names}
        return scene.with_material(own)
    return scene.with_alpha({name: recipe["alpha"][name] for name in scene.part_names})


def recorded_capture(
    recipe: Mapping[str, Any], scene: Scene | MovingHand, device: Device | str | None
) -> Capture:
    """Return the simulated capture of a scene, with the impairments of the recipe."""
    array, waveform = recipe_radar(recipe)
    settings = {**EARLIER_SETTINGS, **recipe["simulation"]}
    if isinstance(scene, MovingHand):
        moving = MovingScene([scene], lambda own: _with_surface(own, recipe))
        capture = simulate_moving(
            moving, array, waveform, timing=_timing(recipe),
            start_s=recipe["movement"]["start_s"], device=device, **settings,
        )  # fmt: skip
    else:
        capture = simulate(scene, array, waveform, device=device, **settings)
    impairments = recipe.get("impairments")
    if not impairments:
        return capture
    errors = {k: v for k, v in impairments.items() if k not in ("channels", "walls")}
    channels = impairments.get("channels")
    if channels is not None:
        errors["channels"] = draw_channels(array, waveform, **channels)
    if impairments.get("walls"):
        walls = [Wall(**wall) for wall in impairments["walls"]]
        errors["room"] = room_capture(array, waveform, walls)
    return impair(capture, **errors, frame=recipe.get("movement", {}).get("frame", 0))


def recipe_radar(recipe: Mapping[str, Any]) -> tuple[AntennaArray, Waveform]:
    """Return antennas and frequencies of a recipe.

    Equal radars give the same objects, and so do equal grids below: image formation then reuses its
    choice of skeleton antennas and frequencies.
    """
    radar = recipe["radar"]
    array = plan_array(radar["array"], radar["every"])
    return array, _waveform(radar["start_hz"], radar["stop_hz"], radar["steps"])


@lru_cache(maxsize=8)
def _waveform(start_hz: float, stop_hz: float, steps: int) -> Waveform:
    return Waveform.sfcw(start_hz, stop_hz, steps)


def recipe_grid(recipe: Mapping[str, Any]) -> VoxelGrid:
    """Return the voxel grid of a recipe that has an image."""
    image = recipe["image"]
    return _grid(*(tuple(image[key]) for key in ("x_m", "y_m", "z_m", "step_m")))


@lru_cache(maxsize=8)
def _grid(x_m: Any, y_m: Any, z_m: Any, step_m: Any) -> VoxelGrid:
    return VoxelGrid.from_extent(x_m, y_m, z_m, step_m)

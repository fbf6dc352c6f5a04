"""From a recipe to a sample: posed hand, simulation, impairments, image."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from clradar.arrays import qar50
from clradar.backproject import backproject
from clradar.channel_errors import draw_channels
from clradar.dataset.hands import pose_of, shape_of
from clradar.errors import ModelError
from clradar.hand import HandMesh, HandPose, hand_mesh
from clradar.hashing import sha256_of
from clradar.impair import impair
from clradar.model import AntennaArray, Capture, Scene, VoxelGrid, Waveform
from clradar.opencl import Device
from clradar.room import Wall, room_capture
from clradar.synthesize import simulate


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One sample: its recipe, and its products as arrays by the names of `layout.FIELDS`."""

    recipe: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]


def make_sample(recipe: Mapping[str, Any], device: Device | str | None = None) -> Sample:
    """Make the sample that a recipe describes.

    Parameters
    ----------
    recipe : mapping
        As `clradar.dataset.recipe` returns it.
    device : Device, str or None
        See `clradar.open_device`.

    Returns
    -------
    Sample
        The products that the recipe lists. On the same device and driver they are the same bits,
        whatever was made before and however many threads there are.
    """
    products = recipe["products"]
    arrays: dict[str, np.ndarray] = {}
    mesh = placed_hand(recipe, device)
    if "joints" in products:
        arrays["joints"] = mesh.joints_m
    if "mesh" in products:
        arrays["mesh_vertices"] = mesh.vertices_m.astype(np.float32)
        arrays["mesh_faces"] = mesh.faces
        arrays["mesh_part"] = mesh.part.astype(np.uint8)
    image = recipe["image"]
    if image is None and "capture" not in products:
        return Sample(recipe, arrays)
    capture = recorded(recipe, scene_of(mesh, recipe["alpha"]), device)
    if "capture" in products:
        arrays["capture"] = capture.data
    if image is not None:
        volume = backproject(
            capture,
            grid_of(recipe),
            method=image["method"],
            window=image["window"],
            tolerance_db=image["tolerance_db"],
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


def placed_hand(recipe: Mapping[str, Any], device: Device | str | None = None) -> HandMesh:
    """Return the hand where the recipe puts it, metres, antenna frame."""
    hand, place = recipe["hand"], recipe["placement"]
    pose = pose_of(recipe["pose"])
    origin_m = (0.0, 0.0, 0.0)
    if "rig" in hand:
        mesh = posed_rig(hand["rig"], pose, hand["handedness"])
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


def posed_rig(record: Mapping[str, Any], pose: HandPose, handedness: str) -> HandMesh:
    """Return a rig's hand in a pose about the origin; a hand of the other side is mirrored."""
    rig = _rig(json.dumps(record))
    mesh = rig.posed(pose, center_m=(0.0, 0.0, 0.0))
    if rig.handedness == handedness:
        return mesh
    return mesh.moved(np.diag([-1.0, 1.0, 1.0]), np.zeros(3))


@lru_cache(maxsize=4)
def _rig(text: str) -> Any:
    from clradar.rigs import read_rig

    record = json.loads(text)
    for key in ("file", "mapping"):
        wanted = record["sha256" if key == "file" else "mapping_sha256"]
        if record[key] is not None and sha256_of(Path(record[key])) != wanted:
            raise ModelError(
                f"{record[key]}: expected the file of the plan (SHA-256 {wanted}), got another"
            )
    return read_rig(
        record["file"],
        mapping=record["mapping"],
        unit=record["unit"],
        handedness=record["handedness"],
        betas=record["betas"] or None,
    )


def rotation(angles_rad: Any) -> np.ndarray:
    """Return the matrix (3, 3) that turns about the fixed axes x, then y, then z: Rz Ry Rx."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    turn_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    turn_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    turn_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return turn_z @ turn_y @ turn_x


def scene_of(mesh: HandMesh, alpha: Mapping[str, float]) -> Scene:
    """Return the scene of a hand whose parts have these alphas."""
    values = np.array([alpha[name] for name in mesh.part_names])[mesh.part]
    return Scene(mesh.vertices_m, mesh.faces, values, mesh.part, mesh.part_names, mesh.normals)


def recorded(recipe: Mapping[str, Any], scene: Scene, device: Device | str | None) -> Capture:
    """Return what the recipe's radar records of a scene, impairments included."""
    array, waveform = instrument(recipe)
    capture = simulate(scene, array, waveform, device=device, **recipe["simulation"])
    faults = recipe["impairments"]
    if faults is None:
        return capture
    settings = {key: value for key, value in faults.items() if key not in ("channels", "walls")}
    channels = faults["channels"]
    if channels is not None:
        settings["channels"] = draw_channels(array, waveform, **channels)
    if faults["walls"]:
        walls = [Wall(**wall) for wall in faults["walls"]]
        settings["room"] = room_capture(array, waveform, walls)
    return impair(capture, **settings)


def instrument(recipe: Mapping[str, Any]) -> tuple[AntennaArray, Waveform]:
    """Return antennas and frequencies of a recipe.

    The same radar gives the same objects, and so does the same grid below: by that, image
    formation knows that it need not choose antennas and frequencies anew.
    """
    radar = recipe["radar"]
    return _array(radar["every"]), _waveform(radar["start_hz"], radar["stop_hz"], radar["steps"])


@lru_cache(maxsize=8)
def _array(every: int) -> AntennaArray:
    known = qar50()
    if every == 1:
        return known
    return AntennaArray(known.tx_m[::every], known.rx_m[::every], f"{known.name}, one in {every}")


@lru_cache(maxsize=8)
def _waveform(start_hz: float, stop_hz: float, steps: int) -> Waveform:
    return Waveform.sfcw(start_hz, stop_hz, steps)


def grid_of(recipe: Mapping[str, Any]) -> VoxelGrid:
    """Return the voxel grid of a recipe that has an image."""
    image = recipe["image"]
    return _grid(*(tuple(image[key]) for key in ("x_m", "y_m", "z_m", "step_m")))


@lru_cache(maxsize=8)
def _grid(x_m: Any, y_m: Any, z_m: Any, step_m: Any) -> VoxelGrid:
    return VoxelGrid.from_extent(x_m, y_m, z_m, step_m)

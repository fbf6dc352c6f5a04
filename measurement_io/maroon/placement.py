"""Check where meshes are placed, by `alignment.json`, against `metadata.json` and folder names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.failures import clean
from clradar.model import Scene
from measurement_io.maroon.alignment import (
    SensorAlignment,
    named_transforms,
    read_alignment,
    stretches,
)
from measurement_io.maroon.folders import ALIGNMENT_FILE, MESH_FOLDER, METADATA_FILE
from measurement_io.maroon.metadata import MaskBox, RecordingMetadata, read_metadata
from measurement_io.maroon.recording import MESH_SOURCE, mesh_files, placed_mesh
from measurement_io.record_facts import Fact, json_line, millimetres

Record = TypeVar("Record")

SAME_STRETCH = 1e-3
"""Largest relative difference of stretches that are called the same: matrices that were measured
and rounded are not orthogonal to the last digit."""

MESH_DISTANCE_TOLERANCE_M = 0.05
"""How far the nearest part of a mesh may be from the distance that is noted: half of the steps in
which objects are placed."""

MASKED_SHARE = 0.5
"""Fraction of the vertices of a mesh cut to the object that should be in the object's box."""


def inspect_placement(
    distance: Path, facts: list[Fact], problems: list[str], missing: list[str]
) -> None:
    """Add what lies in an `<object>/<distance>` folder to what has been found."""
    metadata = _metadata(distance, facts, problems, missing)
    alignment = _alignment(distance, facts, problems, missing)
    try:
        meshes = mesh_files(distance)
    except MeasurementError as error:  # the folder itself, such as one without permission
        facts.append(Fact("meshes", "cannot be read", None))
        problems.append(clean(error))
        return
    if not meshes:
        missing.append(f"{MESH_FOLDER}/*.obj")
        facts.append(Fact("meshes", "none", {}))
        return
    if alignment is not None:
        try:
            alignment.to_antenna(MESH_SOURCE)
        except MeasurementError as error:  # once, and not for every mesh
            problems.append(clean(error))
            alignment = None
    lines, values = [], {}
    for name in sorted(meshes):
        value: dict[str, Any] | None = None
        words = "cannot be placed"
        if alignment is not None:
            try:
                scene = placed_mesh(distance, name, alignment)
            except MeasurementError as error:
                problems.append(clean(error))
                words = "cannot be read"
            else:
                value = _mesh_value(scene, metadata)
                words = _mesh_words(value)
                problems += _mesh_problems(name, scene, value, metadata)
        lines.append(f"{clean(name)}: {words}")
        values[clean(name)] = value
    facts.append(Fact("meshes", "\n".join(lines), values))


def _read_if_there(
    path: Path, read: Callable[[Path], Record], facts: list[Fact], problems: list[str]
) -> Record | None:
    """Read a file; note a problem where that fails."""
    if not path.exists():
        facts.append(Fact(path.name, "none", None))
        return None
    try:
        return read(path)
    except MeasurementError as error:
        facts.append(Fact(path.name, "cannot be read", None))
        problems.append(clean(error))
        return None


def _metadata(
    distance: Path, facts: list[Fact], problems: list[str], missing: list[str]
) -> RecordingMetadata | None:
    path = distance / METADATA_FILE
    if not path.exists():
        missing.append(METADATA_FILE)
    metadata = _read_if_there(path, read_metadata, facts, problems)
    if metadata is None:
        return None
    value = {
        "distance_meters": metadata.distance_meters,
        "calibration": metadata.calibration,
        "calibration_fine": metadata.calibration_fine,
        "mask_erosion": metadata.mask_erosion,
        "labels": metadata.labels,
        "empty_measurement": metadata.empty_measurement,
    }
    lines = [f"{key}: {json_line(item)}" for key, item in value.items() if item is not None]
    value["mask_bb"] = None if metadata.mask_bb is None else asdict(metadata.mask_bb)
    value["mask_bb_antenna"] = None
    if metadata.mask_bb_antenna is not None:
        value["mask_bb_antenna"] = asdict(metadata.mask_bb_antenna)
        lines.append(f"mask_bb, antenna frame: {_box_words(metadata.mask_bb_antenna)}")
        turned = metadata.mask_bb_antenna.reversed_axes
        if turned:
            lines.append(f"mask_bb has its minimum above its maximum along {', '.join(turned)}")
    value["other"] = dict(metadata.other)
    if metadata.other:
        lines.append(f"unknown keys: {clean(', '.join(sorted(metadata.other)))}")
    facts.append(Fact(METADATA_FILE, "\n".join(lines) or "nothing in it", value))
    problem = metadata.distance_problem(distance.name)
    if problem is not None:
        problems.append(problem)
    return metadata


def _box_words(box: MaskBox) -> str:
    parts = []
    for axis, (low, high) in zip("xyz", box.bounds_m, strict=True):
        ends = ["-" if bound is None else f"{1e3 * bound:.6g}" for bound in (low, high)]
        parts.append(f"{axis} {ends[0]} to {ends[1]}")
    return ", ".join(parts) + " mm"


def _alignment(
    distance: Path, facts: list[Fact], problems: list[str], missing: list[str]
) -> SensorAlignment | None:
    path = distance / ALIGNMENT_FILE
    if not path.exists():
        missing.append(f"{ALIGNMENT_FILE}, without which no mesh can be placed")
    alignment = _read_if_there(path, read_alignment, facts, problems)
    if alignment is None:
        return None
    lines, values = [], {}
    for name, matrix in named_transforms(alignment):
        scale = stretches(matrix)
        even = bool(scale[0] - scale[-1] <= SAME_STRETCH * scale[0])
        rigid = even and bool(abs(scale[0] - 1.0) <= SAME_STRETCH)
        mirrors = bool(np.linalg.det(matrix[:3, :3]) < 0)
        kind = "rigid" if rigid else f"scale {scale[0]:.6g}"
        if not even:
            kind = "stretches by " + ", ".join(f"{s:.6g}" for s in scale)
            problems.append(f"{ALIGNMENT_FILE}: {clean(name)} distorts: it {kind}")
        if mirrors:
            kind += ", mirrors"
        lines.append(f"{clean(name)}: {kind}")
        values[clean(name)] = {
            "matrix": matrix.tolist(),
            "stretches": scale.tolist(),
            "rigid": rigid,
            "mirrors": mirrors,
        }
    if alignment.unknown_keys:
        lines.append(f"no transforms: {clean(', '.join(alignment.unknown_keys))}")
    value = {"transforms": values, "unknown_keys": list(alignment.unknown_keys)}
    facts.append(Fact(ALIGNMENT_FILE, "\n".join(lines) or "no transform in it", value))
    problems += [clean(problem) for problem in alignment.problems()]
    return alignment


def _mesh_value(scene: Scene, metadata: RecordingMetadata | None) -> dict[str, Any]:
    used = scene.vertices_m[np.unique(scene.faces)]
    box = None if metadata is None else metadata.mask_bb_antenna
    return {
        "vertices": len(used),
        "faces": scene.n_faces,
        "low_m": used.min(axis=0).tolist(),
        "high_m": used.max(axis=0).tolist(),
        "share_in_mask_bb": None if box is None else float(box.contains(used).mean()),
    }


def _mesh_words(value: dict[str, Any]) -> str:
    low, high = value["low_m"], value["high_m"]
    size = millimetres([b - a for a, b in zip(low, high, strict=True)])
    words = (
        f"{value['vertices']} vertices, {value['faces']} faces, {size}, "
        f"at z {1e3 * low[2]:.6g} to {1e3 * high[2]:.6g} mm"
    )
    share = value["share_in_mask_bb"]
    return words if share is None else f"{words}, {share:.1%} of its vertices in mask_bb"


def _mesh_problems(
    name: str, scene: Scene, value: dict[str, Any], metadata: RecordingMetadata | None
) -> list[str]:
    label = f"{MESH_FOLDER}/{clean(name)}.obj"
    near, far = value["low_m"][2], value["high_m"][2]
    problems = []
    if far <= 0:
        problems.append(
            f"{label} is placed behind the radar, z {1e3 * near:.6g} to {1e3 * far:.6g} mm"
        )
    elif near <= 0:
        problems.append(f"{label} reaches behind the radar, to z {1e3 * near:.6g} mm")
    distance = None if metadata is None else metadata.distance_meters
    if distance is not None and not (
        near - MESH_DISTANCE_TOLERANCE_M <= distance <= far + MESH_DISTANCE_TOLERANCE_M
    ):
        problems.append(
            f"{label} is placed at z {1e3 * near:.6g} to {1e3 * far:.6g} mm, {METADATA_FILE} has "
            f"{distance:g} m"
        )
    share = value["share_in_mask_bb"]
    if share is not None and share < (MASKED_SHARE if "masked" in name else 1 / value["vertices"]):
        problems.append(
            f"{label}: {share:.1%} of its vertices are in the mask_bb of {METADATA_FILE}"
        )
    return problems

"""Files with the regions of a mesh, and with the joints of a hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.files.failures import fail, read_bytes, reading
from clradar.files.json_file import read_json
from clradar.files.json_text import parse_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES

if TYPE_CHECKING:
    from calibration import Regions
    from clradar import Scene

LIMIT_BYTES = 2**28


def read_regions(path: Path, scene: Scene) -> Regions:
    """The regions of a mesh in a file.

    A .npy file has one whole number per face; a .json file has a list of one number or string per
    face, or an object: region -> list of the names of its parts.

    Raises
    ------
    MeasurementError
        Missing, or no regions of this mesh.
    """
    from calibration import Regions

    expected = "'parts', 'fingers', or a .npy or .json file with a label for each face"
    content = read_bytes(path, expected, LIMIT_BYTES)
    with reading(path, expected):
        if path.suffix.lower() == ".npy":
            labels: Any = np.load(path, allow_pickle=False)
            if labels.dtype.kind not in "iu":
                fail(path, "whole numbers", f"{labels.dtype}")
        else:
            labels = parse_json(content.decode("utf-8-sig"))
        if isinstance(labels, dict):
            if not all(_all_are(names, str) for names in labels.values()):
                fail(path, "lists of names of parts", "something else")
            return Regions.of_parts(scene, labels)
        if isinstance(labels, list) and not (_all_are(labels, int) or _all_are(labels, str)):
            fail(path, "a list of whole numbers or of strings", "something else")
        if np.shape(labels) != (scene.n_faces,):
            fail(path, f"{scene.n_faces} labels, one per face", f"shape {np.shape(labels)}")
        return Regions.of_labels(labels)


def _all_are(values: Any, kind: type) -> bool:
    return isinstance(values, list) and all(type(value) is kind for value in values)


def read_joints(path: Path) -> np.ndarray:
    """The joints of a JSON object name -> [x, y, z], shape (25, 3), in the file's unit."""
    from clradar.hand import JOINT_NAMES

    expected = "a JSON object with [x, y, z] of each of the 25 joints of a hand"
    value = read_json(path, expected, MAX_SMALL_JSON_BYTES)
    with reading(path, expected):
        missing = [name for name in JOINT_NAMES if name not in value]
        if missing:
            fail(path, expected, f"none of {missing[0]} and {len(missing) - 1} more")
        joints = np.array([value[name] for name in JOINT_NAMES], dtype=np.float64)
        if joints.shape != (len(JOINT_NAMES), 3) or not np.isfinite(joints).all():
            fail(path, expected, f"numbers of shape {joints.shape}, or not finite")
        return joints


def joints_record(joints: np.ndarray) -> dict[str, list[float] | None]:
    """The JSON object that `read_joints` reads; None, which it refuses, for an unknown joint."""
    from clradar.hand import JOINT_NAMES

    return {
        name: at.tolist() if np.isfinite(at).all() else None
        for name, at in zip(JOINT_NAMES, joints, strict=True)
    }

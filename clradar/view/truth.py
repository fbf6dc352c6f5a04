"""What a frame was made of: of a sample of a data set, and of a frame of a simulated recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import ClradarError
from clradar.files.json_file import read_json_object
from clradar.hand import JOINT_NAMES
from clradar.hand.joints import CHAINS
from measurement_io.maroon.folders import find_radar_folder

FILE = "truth/truth.json"
"""Beside the radar folder, as ``clradar simulate --motion --frames`` writes it."""

COLOUR = (90, 200, 255)

UNITS_PER_M = 10.0
"""Of the scene: with a hand of two units, steps and clipping of the camera's defaults fit."""

BONES = np.array([pair for chain in CHAINS for pair in pairwise((0, *chain))])


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a frame was made of, as far as it is known.

    Joints, (25 * hands, 3), are in the order of `clradar.hand.JOINT_NAMES`, NaN where a rig has
    none; `lines` are pose, hand, place and surface as text.
    """

    vertices_m: np.ndarray | None
    faces: np.ndarray | None
    joints_m: np.ndarray | None
    lines: tuple[str, ...]


def recording_truth(
    path: Path, label: Callable[[int], str]
) -> Callable[[int], Truth | None] | None:
    """Return the truth beside a recording, by the labels of its frames; None where there is none,
    or it cannot be read.
    """
    with suppress(ClradarError):
        radar = find_radar_folder(path)
        for file in (radar / FILE, radar.parent / FILE):
            if file.is_file():
                frames = read_json_object(file).get("frames")
                records = frames if isinstance(frames, list) else []
                known = {f"frame {r.get('frame')}": r for r in records if isinstance(r, Mapping)}
                return lambda frame: _truth_of(known.get(label(frame)))
    return None


def _truth_of(record: Mapping[str, Any] | None) -> Truth | None:
    """Return joints and poses of a frame."""
    if record is None:
        return None
    with suppress(AttributeError, IndexError, TypeError, ValueError):  # not as it is written
        hands = record.get("hands", [record])
        joints = [one["joints_m"] for one in hands if one.get("joints_m")]
        places = [[one.get(name) or [np.nan] * 3 for name in JOINT_NAMES] for one in joints]
        joints_m = np.array(places, np.float64).reshape(-1, 3) if places else None
        lines = [f"pose {one['pose']}" for one in hands if one.get("pose")]
        for name, matrix in record.get("bodies", {}).items():
            x, y, z = 1e3 * np.array(matrix, np.float64)[:3, 3]
            lines.append(f"{name} at ({x:.1f}, {y:.1f}, {z:.1f}) mm")
        return Truth(None, None, joints_m, tuple(lines))
    return None


def draw_truth(scene: Any, truth: Truth | None) -> list[Any]:
    """Draw mesh and joints, where they are known, into the scene of viser; return their nodes."""
    nodes = []
    if truth is not None and truth.vertices_m is not None:
        nodes.append(
            scene.add_mesh_simple(
                "/3-D/truth/mesh", vertices=UNITS_PER_M * truth.vertices_m, faces=truth.faces,
                color=COLOUR, opacity=0.4, side="double",
            )
        )  # fmt: skip
    if truth is not None and truth.joints_m is not None:
        joints_m = truth.joints_m.reshape(-1, len(JOINT_NAMES), 3)
        ends = (UNITS_PER_M * joints_m[:, BONES].reshape(-1, 2, 3)).astype(np.float32)
        nodes.append(
            scene.add_line_segments(
                "/3-D/truth/joints", points=ends[np.isfinite(ends).all(axis=(1, 2))],
                colors=COLOUR, thickness=3.0, thickness_units="screen",
            )
        )  # fmt: skip
    return nodes

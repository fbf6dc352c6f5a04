"""Options of sweeps: alphas or roughness, regions of the mesh, and its place."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.options.groups import option, wrong_usage
from clradar.cli.parse import RANGE_RULE, ascending
from clradar.constants import PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.files.failures import fail, read_bytes, reading
from clradar.files.json_file import read_json
from clradar.files.json_text import parse_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.model import checks

if TYPE_CHECKING:
    from calibration import Regions

ALPHAS = "0:1:0.1"


@dataclass(frozen=True, kw_only=True)
class AlphaOptions:
    """The alphas and the seeds to simulate with."""

    alpha: str | None = option(
        f"{RANGE_RULE}, or a list with commas; in [0, 1]. [default: {ALPHAS}]",
        metavar="RANGE",
        without="--roughness-mm",
    )
    seeds: int = option("Simulations per alpha, each its own seed.", 3, metavar="N")
    seed: int = option("The first seed.", 0, metavar="N")

    def __post_init__(self) -> None:
        checks.whole("--seeds", self.seeds, 1)

    def alphas(self) -> np.ndarray:
        """The alphas, shape (A,), float64."""
        return ascending("--alpha", self.alpha or ALPHAS, "alphas", (0.0, 1.0), least=2)


@dataclass(frozen=True, kw_only=True)
class RoughnessOptions:
    """Roughness and correlation lengths to simulate with, in place of alphas."""

    roughness_mm: str | None = option(
        "In place of --alpha: RMS heights of the surface, at least three; heights times lengths "
        "times --seeds are 30 or more; as --alpha. Try 0.1:0.6:0.1.",
        metavar="RANGE",
    )
    correlation_mm: str = option(
        "Correlation lengths, as above; a single one is taken for known.",
        "1.5,3,6",
        metavar="RANGE",
        needs="--roughness-mm",
    )
    calibrated: bool = option(
        "MEASURED is in S-parameters, and its level counts.", False, needs="--roughness-mm"
    )

    def grid_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Heights and correlation lengths, metres."""
        ranges = {
            "--roughness-mm": (self.roughness_mm, "heights", PLAUSIBLE_ROUGHNESS_M),
            "--correlation-mm": (self.correlation_mm, "lengths", PLAUSIBLE_CORRELATION_M),
        }
        heights, lengths = (
            ascending(name, str(text), noun, (1e3 * low, 1e3 * high)) / 1e3
            for name, (text, noun, (low, high)) in ranges.items()
        )
        return heights, lengths


PARTS, FINGERS = "parts", "fingers"

LIMIT_BYTES = 2**28


@dataclass(frozen=True, kw_only=True)
class RegionOptions:
    """Regions of the mesh that have an alpha each."""

    regions: str | None = option(
        "Find an alpha for each named part, for fingers and palm, or for the regions of a file: "
        ".npy or .json with a label per face, or .json with region: [parts].",
        metavar="parts|fingers|FILE",
    )
    joints: Path | None = option(
        "For --regions fingers of a mesh without parts: joints as `clradar hand --joints` writes "
        "them, in the unit of the mesh.",
        metavar="JOINTS.json",
    )

    def __post_init__(self) -> None:
        if self.joints is not None and self.regions != FINGERS:
            raise wrong_usage("--joints", "expected --regions fingers with it")

    @property
    def files(self) -> list[Path]:
        """Files of joints and regions."""
        named = [] if self.regions in (None, PARTS, FINGERS) else [Path(str(self.regions))]
        return [*([] if self.joints is None else [self.joints]), *named]

    def read(self, scene: cl.Scene, unit: str) -> Regions | None:
        """The regions of a mesh as it is in its file, whose unit is that of the joints."""
        from calibration import Regions
        from clradar.model.plausible import MESH_UNITS_M

        if self.regions is None:
            return None
        if self.regions == PARTS:
            return Regions.of_parts(scene)
        if self.regions == FINGERS:
            joints = None if self.joints is None else MESH_UNITS_M[unit] * read_joints(self.joints)
            return Regions.of_fingers(scene, joints)
        return _read_regions(Path(self.regions), scene)


def _read_regions(path: Path, scene: cl.Scene) -> Regions:
    """A number or string for each face, or names of parts by region."""
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

    known = (at.tolist() if np.isfinite(at).all() else None for at in joints)
    return dict(zip(JOINT_NAMES, known, strict=True))

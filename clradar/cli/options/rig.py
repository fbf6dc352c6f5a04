"""A rigged hand from a file, in place of the embedded one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.options.groups import given, option
from clradar.cli.options.values import numbers, wrong_usage
from clradar.files.failures import fail
from clradar.files.json_file import read_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES

if TYPE_CHECKING:
    from clradar.hand import HandMesh, HandPose
    from clradar.rigs import Rig

HAND_CREASE_DEG = 90.0
"""Up to here faces of a hand stand for a curve: a finger of six sides has edges of 60 degrees."""

HIGHEST_HZ = 82e9
"""Of the imager that the command line simulates."""


@dataclass(frozen=True, kw_only=True)
class RigFileOptions:
    """A rigged hand."""

    rig: Path | None = option(
        None,
        "Pose this hand instead of the embedded one: skinned glTF (.glb, .gltf) or a MANO "
        "model (.pkl, .npz). Its mesh is taken as it is.",
        metavar="HAND",
    )
    mapping: Path | None = option(
        None,
        "Which node of the rig is which joint, where it has no WebXR names: a table [joints].",
        metavar="M.toml",
    )
    rig_unit: str | None = option(
        None,
        "The rig's unit of length: m, cm, mm, inch, or a number of millimetres. "
        "[default: found from the hand's size]",
        metavar="UNIT",
    )
    rig_hand: str | None = option(
        None,
        "Which hand the rig is, right or left, if neither names nor shape show it, or "
        "which of two.",
        metavar="SIDE",
    )
    betas: str | None = option(None, "Shape of a MANO hand, up to 10 numbers.", metavar="B,B,...")

    def __post_init__(self) -> None:
        if self.rig is None:
            for name in given(self):
                raise wrong_usage(name, "expected together with --rig")

    @property
    def files(self) -> list[Path]:
        """The files that were given."""
        return [path for path in (self.rig, self.mapping) if path is not None]

    @property
    def keys(self) -> dict[str, Any]:
        """What is given beside the files, as keys of a motion file."""
        unit = None if self.rig_unit is None else _unit(self.rig_unit)
        keys = {
            "rig_unit": 1e3 * unit if isinstance(unit, float) else unit,
            "rig_hand": self.rig_hand,
            "betas": None if self.betas is None else numbers(self.betas),
        }
        return {key: value for key, value in keys.items() if value is not None}

    def read(self) -> Rig:
        """The rig of the file."""
        from clradar.rigs import read_rig

        assert self.rig is not None
        if self.rig_hand not in (None, "right", "left"):
            raise wrong_usage("--rig-hand", f"expected right or left, got '{self.rig_hand}'")
        betas = None if self.betas is None else numbers(self.betas)
        if betas == []:
            raise wrong_usage("--betas", f"expected numbers, got '{self.betas}'")
        return read_rig(
            self.rig,
            mapping=self.mapping,
            unit=None if self.rig_unit is None else _unit(self.rig_unit),
            handedness=self.rig_hand,
            betas=betas,
        )


@dataclass(frozen=True, kw_only=True)
class RigOptions(RigFileOptions):
    """A rigged hand, and its pose in its own parameters."""

    theta: Path | None = option(
        None,
        "Pose of a MANO hand instead of POSE: a list of 48 numbers, axis times angle, radians.",
        metavar="THETA.json",
    )

    @property
    def files(self) -> list[Path]:
        """The files that were given."""
        return [*super().files, *([] if self.theta is None else [self.theta])]

    def posed(self, pose: HandPose, name: str, center_m: Sequence[float]) -> tuple[HandMesh, str]:
        """The rig's surface in a pose, or at a theta of MANO; and both in words."""
        from clradar import Scene, SimulationSettings
        from clradar.rigs import rotations_of_theta
        from clradar.tracing.facets import warn_of_coarse_facets

        rig = self.read()
        if self.theta is None:
            mesh, shown = rig.posed(pose, center_m), f"'{name}'"
        else:
            rotations = rotations_of_theta(rig, read_theta(self.theta))
            mesh, shown = rig.turned(rotations, center_m), f"theta of {self.theta}"
        # A hand has no sharp edges, however coarse its mesh is; at the imager's highest frequency.
        smooth = SimulationSettings(crease_deg=HAND_CREASE_DEG).resolved()
        scene = Scene(mesh.vertices_m, mesh.faces, 0.5)
        warn_of_coarse_facets(str(self.rig), scene, smooth, HIGHEST_HZ)
        joints = f"{int(rig.known.sum())} of {len(rig.known)} joints"
        hand = f"{rig.handedness} hand, unit {unit_text(rig.unit_m)}"
        return mesh, f"{self.rig}: {hand}, {joints}, {shown}"


def read_theta(path: Path) -> list[float]:
    """The numbers of a JSON list."""
    expected = "a JSON list of 48 numbers"
    values = read_json(path, expected, MAX_SMALL_JSON_BYTES)
    if not isinstance(values, list) or not all(type(v) in (int, float) for v in values):
        fail(path, expected, "something else")
    if len(values) != 48:
        fail(path, expected, f"{len(values)}")
    return values


def unit_text(unit_m: float) -> str:
    """The name of a unit of length; millimetres where it has none."""
    from clradar.rigs import UNITS_M

    named = (name for name, value_m in UNITS_M.items() if math.isclose(unit_m, value_m))
    return next(named, f"{1e3 * unit_m:.6g} mm")


def _unit(text: str) -> str | float:
    from clradar.rigs import UNITS_M

    if text in UNITS_M:
        return text
    values_mm = numbers(text)
    if len(values_mm) != 1 or not 0 < values_mm[0] < float("inf"):
        raise wrong_usage(
            "--rig-unit",
            f"expected one of {', '.join(UNITS_M)}, or a positive number of mm, got '{text}'",
        )
    return values_mm[0] / 1e3

"""Options of hands: shape, rigs of files, pose, and the fit of one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli import parse
from clradar.cli.groups import argument, arguments_of, option, wrong_usage
from clradar.cli.options.measured import SearchOptions, alpha_or_fit, own_option, rig_option
from clradar.files.failures import fail
from clradar.files.json_file import read_json
from clradar.model import checks

if TYPE_CHECKING:
    from clradar.hand import HandMesh, HandPose, HandShape
    from clradar.opencl import Device
    from clradar.rigs import Rig


@dataclass(frozen=True, kw_only=True)
class ShapeOptions:
    """Size and proportions of the embedded hand."""

    length_mm: float | None = own_option("Wrist crease to middle fingertip. [default: 187.4]")
    breadth_mm: float | None = own_option("Across the knuckles. [default: 85.6]")
    finger_lengths: tuple[float, float, float, float, float] | None = own_option(
        "Thumb to little finger, relative to an average hand of this length.", metavar="T I M R P"
    )
    girth: float | None = own_option("Thickness, relative to an average hand of this breadth.")

    @property
    def shape(self) -> HandShape | None:
        """Length, breadth, finger lengths, girth, if there is one of them."""
        from clradar.hand import HandShape

        known = arguments_of(self, ShapeOptions)
        return HandShape(**known) if known else None


def _unit_of_rig(option: str, text: str) -> str | float:
    """The name of the unit, or its millimetres."""
    from clradar.rigs import UNITS_M

    if text in UNITS_M:
        return text
    values_mm = parse.numbers(text)
    if len(values_mm) != 1 or values_mm[0] <= 0:
        known = f"one of {', '.join(UNITS_M)}, or a positive number of mm"
        raise wrong_usage(option, f"expected {known}, got '{text}'")
    return values_mm[0]


@dataclass(frozen=True, kw_only=True)
class RigOptions:
    """A rigged hand."""

    rig: Path | None = option(
        "Pose this hand instead: skinned glTF (.glb, .gltf) or a MANO model (.pkl, .npz).",
        metavar="HAND",
        needs="--fit-hand",
    )
    mapping: Path | None = rig_option(
        "Which node is which joint, without WebXR names: a table [joints].", metavar="M.toml"
    )
    rig_unit: str | float | None = rig_option(
        "m, cm, mm, inch, or a number of mm. [default: m]",
        metavar="UNIT",
        parse=_unit_of_rig,
    )
    rig_hand: Literal["right", "left"] | None = rig_option(
        "Which hand the rig is. [default: as its names say, else right]"
    )
    betas: tuple[float, ...] | None = rig_option(
        "Shape of a MANO hand, up to 10 numbers.",
        metavar="B,B,...",
        parse=parse.some,
    )

    def read_rig(self) -> Rig:
        """The rig of the file."""
        from clradar.rigs import read_rig

        assert self.rig is not None
        unit = self.rig_unit / 1e3 if isinstance(self.rig_unit, float) else self.rig_unit
        return read_rig(
            self.rig, mapping=self.mapping, unit=unit, handedness=self.rig_hand, betas=self.betas
        )


@dataclass(frozen=True, kw_only=True)
class HandOptions(ShapeOptions, RigOptions, SearchOptions):
    """What is known of the hand that is fitted to one image or to frames."""

    hand: Literal["right", "left", "either"] | None = own_option(
        "Which hand it is. [default: right; that of an earlier fit, or of the rig]"
    )
    fit_shape: bool = own_option("Fit size and proportions of the hand, too.", False)
    angle_std_deg: float = option(
        "Standard deviation of flexion from the starting pose.",
        12.0,
        needs="--fit-hand",
        check=checks.positive,
    )
    seed: int = option("Of all that is drawn.", 0, needs="--fit-hand")

    def settings(self, starts: StartNames) -> dict[str, Any]:
        """The arguments that `calibration.fit_hand` and `calibration.fit_hands` have both."""
        names = ("fit_shape", "angle_std_deg", "search_deg", "seed")
        settings = {"pose": starts.read(self.hand), **{n: getattr(self, n) for n in names}}
        if self.rig is None:
            return {**settings, "handedness": self.hand or "right", "shape": self.shape}
        rig = self.read_rig()
        return {**settings, "rig": rig, "handedness": rig.handedness}


def start_files(text: str) -> list[Path]:
    """The files among the starts of a fit."""
    return StartNames(text).files


class StartNames:
    """Starts of a fit, of poses and files with commas between them."""

    def __init__(self, text: str) -> None:
        from calibration.hand_fit.starts import start_file

        # A comma in the name of a file that exists separates nothing.
        self._texts = [text] if Path(text).exists() else text.split(",")
        self.files = [path for one in self._texts if (path := start_file(one)) is not None]
        # Those in files count by their content.
        self.names = [None if start_file(one) else one for one in self._texts]

    def read(self, hand: str | None) -> tuple[Any, ...]:
        """The starts; an earlier fit has to be of the hand that was given, if it was."""
        from calibration.hand_fit.starts import starts_of

        starts = starts_of(self._texts)
        for start in starts:
            if hand is not None and start.handedness not in (None, hand):
                text = f"expected {start.handedness}, as in --pose, got '{hand}'"
                raise wrong_usage("--hand", text)
        return starts


def _angle_deg(option: str, value: float) -> float:
    if not abs(value) <= 360.0:
        text = f"expected an angle from -360 to 360 degrees, got {value:g}"
        raise wrong_usage(option, text)
    return value


def _pose_file(pose: str) -> list[Path]:
    """The pose file: a name without a suffix is none, even if there is one of that name."""
    return [Path(pose)] if Path(pose).suffix else []


@dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """Pose and position of the hand, or the poses that it goes from and to."""

    pose: str | None = argument(
        "Name of the pose (--list shows them), or a pose file (.toml, .json). [default: F]",
        metavar="POSE",
        files=_pose_file,
    )
    center_mm: tuple[float, float, float] = option(
        "Centre of the bounding box.", (0.0, 0.0, 300.0), metavar="X Y Z"
    )
    turn_deg: float = option(
        "Turn about the vertical through the centre; positive brings +x nearer.",
        0.0,
        check=_angle_deg,
    )
    start: str | None = option(
        "Go from this pose to that of --to: -o is a motion file (.toml) for `clradar simulate`.",
        None,
        "--from",
        metavar="POSE",
        needs="--to",
        without="POSE --joints",
        files=_pose_file,
    )
    end: str | None = option(
        "The last pose.", None, "--to", metavar="POSE", needs="--from", files=_pose_file
    )
    duration_s: float = option(
        "Time from pose to pose.", 1.0, needs="--from", check=checks.positive
    )


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions(ShapeOptions, RigOptions):
    """The surface: the embedded hand, or a rig in a pose of its own parameters."""

    edge_mm: float | None = own_option("About the length of an edge. [default: 1.7]")
    left: bool = own_option("A left hand.", False)
    theta: Path | None = option(
        "Pose of a MANO hand instead of POSE: 48 numbers, axis times angle, radians.",
        metavar="THETA.json",
        needs="--rig",
        without="POSE --from",
    )

    @property
    def handedness(self) -> str:
        """Which hand the embedded one is."""
        return "left" if self.left else "right"

    def posed(self, pose: HandPose, center_m: Sequence[float], device: Device) -> HandMesh:
        """The surface of the embedded hand in a pose."""
        from clradar.hand import HandShape, hand_mesh

        return hand_mesh(
            pose, edge_length_m=(1.7 if self.edge_mm is None else self.edge_mm) / 1e3,
            handedness=self.handedness, center_m=center_m, shape=self.shape or HandShape(),
            device=device,
        )  # fmt: skip

    def rigged(self, pose: HandPose, name: str, center_m: Sequence[float]) -> tuple[HandMesh, str]:
        """The rig's surface in a pose, or at a theta of MANO; and a description of both."""
        from clradar.rigs import rotations_of_theta

        rig = self.read_rig()
        if self.theta is None:
            mesh, shown = rig.posed(pose, center_m), f"'{name}'"
        else:
            rotations = rotations_of_theta(rig, read_theta(self.theta))
            mesh, shown = rig.turned(rotations, center_m), f"theta of {self.theta}"
        joints = f"{int(rig.known.sum())} of {len(rig.known)} joints"
        unit = "unit m" if rig.unit_m == 1.0 else f"unit {1e3 * rig.unit_m:.6g} mm"
        return mesh, f"{self.rig}: {rig.handedness} hand, {unit}, {joints}, {shown}"

    def motion_keys(self, folder: Path) -> dict[str, Any]:
        """The hand in a motion file in this folder, which names files as it sees them."""
        if self.rig is not None:
            self.read_rig()  # raises where it is none
            own = {"rig": self.rig, "mapping": self.mapping}
            files = {key: os.path.relpath(at, folder) for key, at in own.items() if at}
            more = {"rig_unit": self.rig_unit, "rig_hand": self.rig_hand, "betas": self.betas}
            return {**files, **{key: value for key, value in more.items() if value is not None}}
        from clradar.hand import HandShape

        shape = self.shape or HandShape()
        keys = {
            "handedness": self.handedness, "length_mm": 1e3 * shape.length_m,
            "breadth_mm": 1e3 * shape.breadth_m, "girth": shape.girth,
            "finger_lengths": shape.finger_lengths,
        }  # fmt: skip
        return keys if self.edge_mm is None else {**keys, "edge_mm": self.edge_mm}


def read_theta(path: Path) -> list[float]:
    """The numbers of a JSON list."""
    expected = "a JSON list of 48 numbers"
    values = read_json(path, expected)
    if not isinstance(values, list) or not all(type(v) in (int, float) for v in values):
        fail(path, expected, "something else")
    if len(values) != 48:
        fail(path, expected, f"{len(values)}")
    return values


@dataclass(frozen=True, kw_only=True)
class HandFitOptions(HandOptions):
    """Where the fit starts, what it fits, and how it searches."""

    pose: str = option(
        "Where the fit starts: a name (`clradar hand --list`), a pose file, the folder of an "
        "earlier fit, several of them, or all: every letter.",
        "all",
        "--pose",
        "--start",
        metavar="POSE,...",
        files=start_files,
    )
    alpha: float | str = alpha_or_fit()
    quick: bool = option(
        "Without the simulations that correct the bias and find alpha: less exact.", False
    )

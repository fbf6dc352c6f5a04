"""Options of hands: shape, rigs of files, movement from pose to pose, and the fit of one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.options.common import SearchOptions, own_option, rig_option
from clradar.cli.options.groups import given, option, wrong_usage
from clradar.cli.parse import FIT, alpha_or_fit, numbers
from clradar.files.atomic import write_file
from clradar.files.failures import fail
from clradar.files.json_file import read_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.files.toml_file import toml_document

if TYPE_CHECKING:
    from clradar.hand import HandMesh, HandPose, HandShape
    from clradar.opencl import Device
    from clradar.rigs import Rig

EDGE_MM = 1.7


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
    def shape(self) -> HandShape:
        """Length, breadth, finger lengths, girth; an average adult's where not given."""
        from clradar.hand import HandShape

        known: dict[str, Any] = {"finger_lengths": self.finger_lengths, "girth": self.girth}
        for name, value_mm in {"length_m": self.length_mm, "breadth_m": self.breadth_mm}.items():
            known[name] = None if value_mm is None else value_mm / 1e3
        return HandShape(**{name: value for name, value in known.items() if value is not None})


@dataclass(frozen=True, kw_only=True)
class EmbeddedHandOptions(ShapeOptions):
    """Size, shape and mesh of the embedded hand."""

    edge_mm: float | None = own_option(f"About the length of an edge. [default: {EDGE_MM}]")
    left: bool = own_option("A left hand.", False)

    @property
    def handedness(self) -> str:
        """Which hand it is, right or left."""
        return "left" if self.left else "right"

    def posed(self, pose: HandPose, center_m: Sequence[float], device: Device) -> HandMesh:
        """The surface of the embedded hand in a pose."""
        from clradar.hand import hand_mesh

        return hand_mesh(
            pose,
            edge_length_m=(EDGE_MM if self.edge_mm is None else self.edge_mm) / 1e3,
            handedness=self.handedness,
            center_m=center_m,
            shape=self.shape,
            device=device,
        )


@dataclass(frozen=True, kw_only=True)
class RigFileOptions:
    """A rigged hand."""

    rig: Path | None = option(
        "Pose this hand instead: skinned glTF (.glb, .gltf) or a MANO model (.pkl, .npz).",
        metavar="HAND",
        needs="--fit-hand",
    )
    mapping: Path | None = rig_option(
        "Which node is which joint, without WebXR names: a table [joints].", metavar="M.toml"
    )
    rig_unit: str | None = rig_option(
        "m, cm, mm, inch, or a number of mm. [default: by the hand's size]", metavar="UNIT"
    )
    rig_hand: Literal["right", "left"] | None = rig_option(
        "Which hand the rig is, where its names and shape do not show it."
    )
    betas: str | None = rig_option("Shape of a MANO hand, up to 10 numbers.", metavar="B,B,...")

    @property
    def files(self) -> list[Path]:
        """The files that were given."""
        return [path for path in (self.rig, self.mapping) if path is not None]

    @property
    def unit(self) -> str | float | None:
        """The name of the unit, or its metres."""
        from clradar.rigs import UNITS_M

        if self.rig_unit is None or self.rig_unit in UNITS_M:
            return self.rig_unit
        values_mm = numbers(self.rig_unit)
        if len(values_mm) != 1 or values_mm[0] <= 0:
            known = f"one of {', '.join(UNITS_M)}, or a positive number of mm"
            raise wrong_usage("--rig-unit", f"expected {known}, got '{self.rig_unit}'")
        return values_mm[0] / 1e3

    @property
    def keys(self) -> dict[str, Any]:
        """What is given beside the files, as keys of a motion file."""
        betas = None if self.betas is None else numbers(self.betas)
        if betas == []:
            raise wrong_usage("--betas", f"expected numbers, got '{self.betas}'")
        unit = 1e3 * self.unit if isinstance(self.unit, float) else self.unit
        keys = {"rig_unit": unit, "rig_hand": self.rig_hand, "betas": betas}
        return {key: value for key, value in keys.items() if value is not None}

    def read(self) -> Rig:
        """The rig of the file."""
        from clradar.rigs import read_rig

        assert self.rig is not None
        return read_rig(
            self.rig, mapping=self.mapping, unit=self.unit, handedness=self.rig_hand,
            betas=self.keys.get("betas"),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RigOptions(RigFileOptions):
    """A rigged hand, and its pose in its own parameters."""

    theta: Path | None = option(
        "Pose of a MANO hand instead of POSE: 48 numbers, axis times angle, radians.",
        metavar="THETA.json",
        needs="--rig",
        without="POSE --from",
    )

    @property
    def files(self) -> list[Path]:
        """The files that were given."""
        return [*super().files, *([] if self.theta is None else [self.theta])]

    def posed(self, pose: HandPose, name: str, center_m: Sequence[float]) -> tuple[HandMesh, str]:
        """The rig's surface in a pose, or at a theta of MANO; and a description of both."""
        from clradar.rigs import rotations_of_theta

        rig = self.read()
        if self.theta is None:
            mesh, shown = rig.posed(pose, center_m), f"'{name}'"
        else:
            rotations = rotations_of_theta(rig, read_theta(self.theta))
            mesh, shown = rig.turned(rotations, center_m), f"theta of {self.theta}"
        joints = f"{int(rig.known.sum())} of {len(rig.known)} joints"
        unit = "unit m" if rig.unit_m == 1.0 else f"unit {1e3 * rig.unit_m:.6g} mm"
        return mesh, f"{self.rig}: {rig.handedness} hand, {unit}, {joints}, {shown}"


def read_theta(path: Path) -> list[float]:
    """The numbers of a JSON list."""
    expected = "a JSON list of 48 numbers"
    values = read_json(path, expected, MAX_SMALL_JSON_BYTES)
    if not isinstance(values, list) or not all(type(v) in (int, float) for v in values):
        fail(path, expected, "something else")
    if len(values) != 48:
        fail(path, expected, f"{len(values)}")
    return values


@dataclass(frozen=True, kw_only=True)
class MovementOptions:
    """From one pose to another."""

    start: str | None = option(
        "Go from this pose to that of --to: -o is a motion file (.toml) for `clradar simulate`.",
        metavar="POSE",
        names=("--from",),
        needs="--to",
        without="POSE --joints",
    )
    end: str | None = option("The last pose.", metavar="POSE", names=("--to",), needs="--from")
    duration_s: float = option("Time from pose to pose.", 1.0, needs="--from")

    def __post_init__(self) -> None:
        if not 0 < self.duration_s < float("inf"):
            raise wrong_usage("--duration-s", f"expected a positive time, got {self.duration_s:g}")

    @property
    def poses(self) -> tuple[str, ...]:
        """Both poses, none without the options."""
        return () if self.start is None or self.end is None else (self.start, self.end)

    @property
    def files(self) -> list[Path]:
        """The pose files."""
        return [Path(pose) for pose in self.poses if Path(pose).suffix]

    def write_motion(
        self,
        path: Path,
        embedded: EmbeddedHandOptions,
        rigged: RigFileOptions,
        center_mm: tuple[float, float, float],
        turn_deg: float,
        *,
        force: bool,
    ) -> None:
        """Write a motion file of the embedded hand, or of a rig; it names files as it sees them."""
        from clradar.hand.pose_file import pose_of

        hand: dict[str, Any] = {"center_mm": list(center_mm)}
        if rigged.rig is not None:
            rigged.read()  # raises where it is none
            own = {"rig": rigged.rig, "mapping": rigged.mapping}
            hand |= {key: os.path.relpath(at, path.parent) for key, at in own.items() if at}
            hand |= rigged.keys
        else:
            shape = embedded.shape
            hand |= {
                "handedness": embedded.handedness, "length_mm": 1e3 * shape.length_m,
                "breadth_mm": 1e3 * shape.breadth_m, "girth": shape.girth,
                "finger_lengths": list(shape.finger_lengths),
            }  # fmt: skip
            if embedded.edge_mm is not None:
                hand["edge_mm"] = embedded.edge_mm
        text = "[[hand]]\n" + toml_document(hand)
        if turn_deg:
            text += f"about_mm = {list(center_mm)}\n[[hand.place]]\ntime_s = 0.0\n"
            text += f"turn_deg = [0.0, {turn_deg!r}, 0.0]\n"
        for time_s, pose in zip((0.0, self.duration_s), self.poses, strict=True):
            pose_of(pose)  # raises where there is none
            named = os.path.relpath(pose, path.parent) if Path(pose).suffix else pose
            text += "[[hand.pose]]\n" + toml_document({"time_s": time_s, "pose": named})
        write_file(path, text.encode(), force=force)


@dataclass(frozen=True, kw_only=True)
class AnyHandOptions:
    """What is known of the hand, of one image or over frames."""

    hand: Literal["right", "left", "either"] | None = own_option(
        "Which hand it is. [default: right; that of an earlier fit, or of the rig]"
    )
    fit_shape: bool = own_option("Fit size and proportions of the hand, too.", False)
    angle_std_deg: float = option(
        "Standard deviation of flexion from the starting pose.", 12.0, needs="--fit-hand"
    )
    seed: int = option("Of all that is drawn.", 0, metavar="N", needs="--fit-hand")

    def settings(
        self, starts: StartNames, shape: ShapeOptions, rigged: RigFileOptions, search_deg: float
    ) -> dict[str, Any]:
        """The arguments that `calibration.fit_hand` and `calibration.fit_hands` have both."""
        from clradar.model import checks

        settings = {
            "pose": starts.read(self.hand),
            "fit_shape": self.fit_shape,
            "angle_std_deg": checks.positive("--angle-std-deg", self.angle_std_deg),
            "search_deg": checks.positive("--search-deg", search_deg),
            "seed": self.seed,
        }
        if rigged.rig is None:
            known = shape.shape if given(shape) else None
            return {**settings, "handedness": self.hand or "right", "shape": known}
        rig = rigged.read()
        return {**settings, "rig": rig, "handedness": rig.handedness}


@dataclass(frozen=True, kw_only=True)
class HandFitOptions(AnyHandOptions, SearchOptions):
    """Where the fit starts, what it fits, and how it searches."""

    pose: str = option(
        "Where the fit starts: a name (`clradar hand --list`), a pose file, the folder of an "
        "earlier fit, several of them, or all: every letter.",
        "all",
        names=("--pose", "--start"),
        metavar="POSE,...",
    )
    alpha: str = option(
        "0 specular to 1 diffuse, or fit: as the brightness falls with the angle.",
        FIT,
        metavar="ALPHA|fit",
    )
    quick: bool = option(
        "Without the simulations that correct the bias and find alpha: less exact.", False
    )

    def fit_settings(self, shape: ShapeOptions, rigged: RigFileOptions) -> dict[str, Any]:
        """The arguments of `calibration.fit_hand`."""
        more = {"alpha": alpha_or_fit(self.alpha), "closed_loop": not self.quick}
        return {**self.settings(StartNames(self.pose), shape, rigged, self.search_deg), **more}


class StartNames:
    """Starts of a fit, of poses and files with commas between them."""

    def __init__(self, text: str) -> None:
        from calibration.hand_fit.starts import start_file

        # A comma in the name of a file that exists separates nothing.
        self._texts = [text] if Path(text).exists() else text.split(",")
        files = [start_file(one) for one in self._texts]
        self.files = [path for path in files if path is not None]
        # Those in files count by their content.
        self.names = [None if f else n for n, f in zip(self._texts, files, strict=True)]

    def read(self, hand: str | None) -> tuple[Any, ...]:
        """The starts; an earlier fit has to be of the hand that was given, if it was."""
        from calibration.hand_fit.starts import starts_of

        starts = starts_of(self._texts)
        for start in starts:
            if hand is not None and start.handedness not in (None, hand):
                text = f"expected {start.handedness}, as in --pose, got '{hand}'"
                raise wrong_usage("--hand", text)
        return starts

"""Options of hands: shape, pose, rigs of files, the way from pose to pose, and the fit of one."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.options.common import SearchOptions
from clradar.cli.options.groups import given, option
from clradar.cli.parse import FIT, alpha_or_fit, numbers, wrong_usage
from clradar.files.atomic import write_file
from clradar.files.failures import fail
from clradar.files.json_file import read_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.files.toml_file import toml_document

if TYPE_CHECKING:
    from calibration.hand_fit.starts import Start
    from clradar import Device
    from clradar.hand import HandMesh, HandPose, HandShape
    from clradar.rigs import Rig

    pass

EDGE_MM = 1.7


@dataclass(frozen=True, kw_only=True)
class ShapeOptions:
    """Size and proportions of the embedded hand."""

    length_mm: float | None = option(
        None, "Wrist crease to middle fingertip. [default: 187.4]", metavar="MM"
    )
    breadth_mm: float | None = option(None, "Across the knuckles. [default: 85.6]", metavar="MM")
    finger_lengths: tuple[float, float, float, float, float] | None = option(
        None,
        "Thumb to little finger, relative to an average hand of this length.",
        metavar="T I M R P",
    )
    girth: float | None = option(
        None, "Thickness, relative to that of an average hand of this breadth."
    )

    @property
    def shape(self) -> HandShape:
        """Length, breadth, finger lengths, girth; an average adult's where not given."""
        from clradar.hand import HandShape

        average = HandShape()
        return HandShape(
            length_m=average.length_m if self.length_mm is None else self.length_mm / 1e3,
            breadth_m=average.breadth_m if self.breadth_mm is None else self.breadth_mm / 1e3,
            finger_lengths=self.finger_lengths or average.finger_lengths,
            girth=average.girth if self.girth is None else self.girth,
        )


@dataclass(frozen=True, kw_only=True)
class EmbeddedHandOptions(ShapeOptions):
    """Size, shape and mesh of the embedded hand."""

    edge_mm: float | None = option(
        None, f"About the length of an edge. [default: {EDGE_MM}]", metavar="MM"
    )
    left: bool = option(False, "A left hand.")

    @property
    def handedness(self) -> str:
        """Which hand it is, right or left."""
        return "left" if self.left else "right"

    def posed(
        self, pose: HandPose, center_m: Sequence[float], device: Device | str | None
    ) -> HandMesh:
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


@dataclass(frozen=True, kw_only=True)
class WayOptions:
    """From one pose to another."""

    start: str | None = option(
        None,
        "Go from this pose to that of --to, from rest to rest: -o is a motion file (.toml) for "
        "`clradar simulate --motion`.",
        metavar="POSE",
        names=("--from",),
    )
    end: str | None = option(None, "The last pose.", metavar="POSE", names=("--to",))
    duration_s: float = option(1.0, "Time from pose to pose.", metavar="S")

    def __post_init__(self) -> None:
        if (self.start is None) != (self.end is None):
            raise wrong_usage("--from", "expected together with --to")
        if self.start is None:
            for name in given(self):
                raise wrong_usage(name, "expected together with --from and --to")
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
        """Write a motion file of the embedded hand, or of a rig."""
        from clradar.hand.movement import pose_of

        for pose in self.poses:
            pose_of(pose)  # raises where there is none
        times_s = (0.0, self.duration_s)
        poses = [
            {"time_s": time_s, "pose": _named(pose, path)}
            for time_s, pose in zip(times_s, self.poses, strict=True)
        ]
        hand: dict[str, Any] = {"center_mm": list(center_mm)}
        if rigged.rig is not None:
            rigged.read()  # raises where it is none
            own = {"rig": rigged.rig, "mapping": rigged.mapping}
            hand |= {k: os.path.relpath(v, path.parent) for k, v in own.items() if v is not None}
            hand |= rigged.keys
        else:
            shape = embedded.shape
            hand |= {"handedness": embedded.handedness, "length_mm": 1e3 * shape.length_m}
            hand |= {"breadth_mm": 1e3 * shape.breadth_m, "girth": shape.girth}
            hand["finger_lengths"] = list(shape.finger_lengths)
            if embedded.edge_mm is not None:
                hand["edge_mm"] = embedded.edge_mm
        text = "[[hand]]\n" + toml_document(hand)
        if turn_deg:
            text += f"about_mm = {list(center_mm)}\n[[hand.place]]\ntime_s = 0.0\n"
            text += f"turn_deg = [0.0, {turn_deg!r}, 0.0]\n"
        text += "".join(f"[[hand.pose]]\n{toml_document(pose)}" for pose in poses)
        write_file(path, text.encode(), force=force)


def _named(pose: str, motion: Path) -> str:
    """A pose as a motion file names it: files relative to it."""
    return os.path.relpath(pose, motion.parent) if Path(pose).suffix else pose


@dataclass(frozen=True, kw_only=True)
class AnyHandOptions:
    """What is known of the hand, of one image or over frames."""

    hand: Literal["right", "left", "either"] | None = option(
        None, "Which hand it is. [default: right; that of an earlier fit, or of the rig]"
    )
    fit_shape: bool = option(False, "Fit size and proportions of the hand, too.")
    angle_std_deg: float = option(
        12.0,
        "How far joints are from those of the starting pose: standard deviation of flexion and of "
        "the thumb; less at the joints that move less.",
        metavar="DEG",
    )
    seed: int = option(0, "Of all that is drawn.", metavar="N")


@dataclass(frozen=True, kw_only=True)
class HandFitOptions(AnyHandOptions, SearchOptions):
    """Where the fit starts, what it fits, and how it searches."""

    pose: str = option(
        "all",
        "Where the fit starts: a name (`clradar hand --list`), a pose file (.toml, .json), the "
        "folder of an earlier fit, several of them with commas, or all: every letter.",
        names=("--pose", "--start"),
        metavar="POSE,...",
    )
    alpha: str = option(
        FIT,
        "0 specular to 1 diffuse, or fit: found from how the brightness falls with the angle.",
        metavar="ALPHA|fit",
    )
    quick: bool = option(
        False,
        "Without the simulations that correct the bias and find alpha: less exact where the hand "
        "is specular.",
    )

    @property
    def poses(self) -> list[str]:
        """The starts, one by one; a comma in the name of a file that exists separates nothing."""
        return [self.pose] if Path(self.pose).exists() else self.pose.split(",")

    @property
    def files(self) -> list[Path]:
        """The files of the starts."""
        from calibration.hand_fit.starts import start_file

        return [path for text in self.poses if (path := start_file(text)) is not None]

    @property
    def named(self) -> list[str | None]:
        """The starts by their names; None for those in files, which count by their content."""
        from calibration.hand_fit.starts import start_file

        return [text if start_file(text) is None else None for text in self.poses]

    def starts(self) -> tuple[Start, ...]:
        """The starts; an earlier fit has to be of the hand that was given, if it was."""
        from calibration.hand_fit.starts import starts_of

        starts = starts_of(self.poses)
        for start in starts:
            if self.hand is not None and start.handedness not in (None, self.hand):
                raise wrong_usage(
                    "--hand", f"expected {start.handedness}, as in --pose, got '{self.hand}'"
                )
        return starts


def sequence_settings(
    fitting: HandFitOptions, shape: ShapeOptions, rigged: RigFileOptions
) -> dict[str, Any]:
    """The arguments of `calibration.fit_hands`, which runs no simulations."""
    if fitting.alpha != FIT:
        raise wrong_usage("--alpha", "frames are fitted without simulations, which alpha is of")
    settings = fit_settings(fitting, shape, rigged)
    return {key: value for key, value in settings.items() if key not in ("alpha", "closed_loop")}


def fit_settings(
    fitting: HandFitOptions, shape: ShapeOptions, rigged: RigFileOptions
) -> dict[str, Any]:
    """The arguments of `calibration.fit_hand`."""
    from clradar.model import checks

    settings = {
        "pose": fitting.starts(),
        "fit_shape": fitting.fit_shape,
        "alpha": alpha_or_fit(fitting.alpha),
        "closed_loop": not fitting.quick,
        "angle_std_deg": checks.positive("--angle-std-deg", fitting.angle_std_deg),
        "search_deg": checks.positive("--search-deg", fitting.search_deg),
        "seed": fitting.seed,
    }
    if rigged.rig is None:
        known = shape.shape if given(shape) else None
        return {**settings, "handedness": fitting.hand or "right", "shape": known}
    for name in given(shape):
        raise wrong_usage(name, "a rig keeps its size and proportions")
    if fitting.fit_shape:
        raise wrong_usage("--fit-shape", "a rig keeps its size and proportions")
    if fitting.hand is not None:
        raise wrong_usage("--hand", "a rig is one hand: --rig-hand says which")
    rig = rigged.read()
    return {**settings, "rig": rig, "handedness": rig.handedness}

"""``clradar hand``: write the mesh of a posed hand."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli.console import print_line, print_table
from clradar.cli.outputs import MESHES, joints_record, save_mesh, turned
from clradar.files.atomic import write_file
from clradar.files.failures import fail
from clradar.files.json_file import read_json, write_json
from clradar.files.toml_file import toml_document
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from clradar.hand import HandMesh, HandPose
    from clradar.opencl import Device


def _angle_deg(option: str, value: float) -> float:
    if not abs(value) <= 360.0:
        text = f"expected an angle from -360 to 360 degrees, got {value:g}"
        raise opt.wrong_usage(option, text)
    return value


@dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """Pose and position of the hand, or the poses that it goes from and to."""

    pose: str | None = opt.argument(
        "Name of the pose (--list shows them), or a pose file (.toml, .json). [default: F]"
    )
    center_mm: tuple[float, float, float] = opt.option(
        "Centre of the bounding box.", (0.0, 0.0, 300.0), metavar="X Y Z"
    )
    turn_deg: float = opt.option(
        "Turn about the vertical through the centre; positive brings +x nearer.",
        0.0,
        check=_angle_deg,
    )
    start: str | None = opt.option(
        "Go from this pose to that of --to: -o is a motion file (.toml) for `clradar simulate`.",
        None,
        "--from",
        metavar="POSE",
        needs="--to",
        without="POSE --joints",
    )
    end: str | None = opt.option("The last pose.", None, "--to", metavar="POSE", needs="--from")
    duration_s: float = opt.option(
        "Time from pose to pose.", 1.0, needs="--from", check=parse.positive
    )

    @property
    def files(self) -> list[Path]:
        """The pose files: a name without a suffix is no file, even if there is one of that name."""
        named = [pose for pose in (self.pose, self.start, self.end) if pose is not None]
        return [Path(pose) for pose in named if Path(pose).suffix]

    @property
    def center_m(self) -> list[float]:
        """The centre in metres."""
        return parse.metres(self.center_mm)


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions(opt.ShapeOptions, opt.RigOptions):
    """The surface: the embedded hand, or a rig in a pose of its own parameters."""

    edge_mm: float | None = opt.own_option("About the length of an edge. [default: 1.7]")
    left: bool = opt.own_option("A left hand.", False)
    theta: Path | None = opt.option(
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
            "finger_lengths": list(shape.finger_lengths),
        }  # fmt: skip
        return keys if self.edge_mm is None else {**keys, "edge_mm": self.edge_mm}


def command(
    *,
    pose: PoseOptions,
    output: Path | None = opt.output_option(
        "Mesh file: .ply, .stl, .obj, .off, .glb; with --from a motion file, .toml."
    ),
    surface: SurfaceOptions,
    joints: Path | None = opt.written(
        "Write the 25 joints, too: name: [x, y, z], metres, in the frame of the mesh.",
        metavar="JOINTS.json",
    ),
    list_poses: bool = opt.option("List the poses and exit.", False, "--list"),
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
) -> None:
    """The mesh is closed, in metres and in the antenna frame, palm to the radar. Files .ply and
    .glb keep palm, thumb, index, middle, ring and pinky apart, so that each can have its own alpha
    and material. A .ply file has the texture, too: the roughness of a material stays on the skin
    from pose to pose.

    With --rig, a hand of one's own is posed: its place in the file, its unit, and whether it is a
    left or a right hand follow from its joints. With --from A --to B the hand goes from pose to
    pose (docs/movement.md).
    """
    from clradar.hand import POSES
    from clradar.hand.pose_file import pose_of

    if list_poses:
        print_table(("pose", "description"), [(n, known.description) for n, known in POSES.items()])
        return
    if output is None:
        raise opt.wrong_usage("-o", "expected a mesh file to write, or --list")
    parse.ends_in(*((".toml",) if pose.start is not None else MESHES))("-o", output)
    if pose.start is not None:
        write_motion(output, pose, surface, force=force)
        ends = f"'{pose.start}' to '{pose.end}'"
        print_line(f"{output}: hand from {ends} in {pose.duration_s:g} s")
        return
    name = pose.pose or "F"
    angles = pose_of(name)
    if surface.rig is None:
        mesh = surface.posed(angles, pose.center_m, open_devices(device).first)
        text = f"hand '{angles.name}'"
    else:
        mesh, text = surface.rigged(angles, name, pose.center_m)
    mesh = turned(mesh, pose.turn_deg, pose.center_m)
    save_mesh(output, mesh, force=force)
    if joints is not None:
        write_json(joints, joints_record(mesh.joints_m), force=force)
    print_line(f"{output}: {text}, {len(mesh.faces)} faces")


def write_motion(path: Path, pose: PoseOptions, surface: SurfaceOptions, *, force: bool) -> None:
    """Write a motion file of the embedded hand, or of a rig."""
    from clradar.hand.pose_file import pose_of

    hand = {"center_mm": list(pose.center_mm), **surface.motion_keys(path.parent)}
    text = "[[hand]]\n" + toml_document(hand)
    if pose.turn_deg:
        text += f"about_mm = {list(pose.center_mm)}\n[[hand.place]]\ntime_s = 0.0\n"
        text += f"turn_deg = [0.0, {pose.turn_deg!r}, 0.0]\n"
    for time_s, name in ((0.0, str(pose.start)), (pose.duration_s, str(pose.end))):
        pose_of(name)  # raises where there is none
        named = os.path.relpath(name, path.parent) if Path(name).suffix else name
        text += "[[hand.pose]]\n" + toml_document({"time_s": time_s, "pose": named})
    write_file(path, text.encode(), force=force)


def read_theta(path: Path) -> list[float]:
    """The numbers of a JSON list."""
    expected = "a JSON list of 48 numbers"
    values = read_json(path, expected)
    if not isinstance(values, list) or not all(type(v) in (int, float) for v in values):
        fail(path, expected, "something else")
    if len(values) != 48:
        fail(path, expected, f"{len(values)}")
    return values

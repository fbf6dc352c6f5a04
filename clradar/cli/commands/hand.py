"""``clradar hand``: write the mesh of a posed hand."""

from __future__ import annotations

import os
from pathlib import Path

from clradar.cli import options as opt, parse
from clradar.cli.console import print_table
from clradar.cli.outputs import MESHES, joints_record, turned, write
from clradar.files.json_text import indented
from clradar.files.toml_file import toml_document
from clradar.jobs import open_devices


def command(
    *,
    pose: opt.PoseOptions,
    output: Path | None = opt.output_option(
        "Mesh file: .ply, .stl, .obj, .off; with --from a motion file, .toml."
    ),
    surface: opt.SurfaceOptions,
    joints: Path | None = opt.written(
        "Write the 25 joints, too: name: [x, y, z], metres, in the frame of the mesh.",
        metavar="JOINTS.json",
    ),
    list_poses: bool = opt.option("List the poses and exit.", False, "--list"),
    device: str | None = opt.DEVICE,
) -> None:
    """The mesh is closed, in metres and in the antenna frame, palm to the radar. A .ply file has
    palm, thumb, index, middle, ring and pinky apart, for an alpha or a material each, and the
    texture, which stays on the skin from pose to pose. Rigs: docs/rigs.md; motion files:
    docs/movement.md.
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
        ends = f"'{pose.start}' to '{pose.end}'"
        text = f"hand from {ends} in {pose.duration_s:g} s"
        write(output, motion_of(output.parent, pose, surface), text)
        return
    name, center_m = pose.pose or "F", opt.scaled(pose.center_mm, 1e3)
    angles = pose_of(name)
    if surface.rig is None:
        mesh = surface.posed(angles, center_m, open_devices(device).first)
        text = f"hand '{angles.name}'"
    else:
        mesh, text = surface.rigged(angles, name, center_m)
    mesh = turned(mesh, pose.turn_deg, center_m)
    write(joints, indented(joints_record(mesh.joints_m)))
    write(output, mesh, f"{text}, {len(mesh.faces)} faces")


def motion_of(folder: Path, pose: opt.PoseOptions, surface: opt.SurfaceOptions) -> str:
    """A motion file in this folder, of the embedded hand or of a rig."""
    from clradar.hand.pose_file import pose_of

    hand = {"center_mm": pose.center_mm, **surface.motion_keys(folder)}
    text = "[[hand]]\n" + toml_document(hand)
    if pose.turn_deg:
        text += f"about_mm = {list(pose.center_mm)}\n[[hand.place]]\ntime_s = 0.0\n"
        text += f"turn_deg = [0.0, {pose.turn_deg!r}, 0.0]\n"
    for time_s, name in ((0.0, str(pose.start)), (pose.duration_s, str(pose.end))):
        pose_of(name)  # raises where there is none
        named = os.path.relpath(name, folder) if Path(name).suffix else name
        text += "[[hand.pose]]\n" + toml_document({"time_s": time_s, "pose": named})
    return text

"""``clradar hand``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import numpy as np
import typer

from clradar.cli.options import DeviceOption, ForceOption, wrong_usage
from clradar.cli.output import check_outputs, print_line, print_table, write_bytes, write_json
from clradar.cli.rig_options import (
    BetasOption,
    MappingOption,
    RigHandOption,
    RigOption,
    RigUnitOption,
    ThetaOption,
    check_alone,
    described,
    opened_rig,
    posed_rig,
)
from clradar.errors import OutputError

if TYPE_CHECKING:
    from clradar.hand import HandMesh

SUFFIXES = (".ply", ".stl", ".obj", ".off", ".glb")
"""What is written; only .glb keeps the parts apart."""

EDGE_MM = 1.7


def command(
    pose: Annotated[
        Optional[str],  # noqa: UP045
        typer.Argument(
            help="Name of the pose (--list shows them), or a pose file (.toml, .json). [default: F]"
        ),
    ] = None,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", help=f"Mesh file: {', '.join(SUFFIXES)}."),
    ] = None,
    edge_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--edge-mm", metavar="MM", help=f"About the length of an edge. [default: {EDGE_MM}]"
        ),
    ] = None,
    left: Annotated[bool, typer.Option("--left", help="A left hand.")] = False,
    length_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--length-mm", metavar="MM", help="Wrist crease to middle fingertip. [default: 187.4]"
        ),
    ] = None,
    breadth_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--breadth-mm", metavar="MM", help="Across the knuckles. [default: 85.6]"),
    ] = None,
    finger_lengths: Annotated[
        Optional[tuple[float, float, float, float, float]],  # noqa: UP045
        typer.Option(
            "--finger-lengths",
            metavar="T I M R P",
            help="Thumb to little finger, relative to an average hand of this length.",
        ),
    ] = None,
    girth: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--girth", help="Thickness, relative to that of an average hand of this breadth."
        ),
    ] = None,
    center_mm: Annotated[
        tuple[float, float, float],
        typer.Option("--center-mm", metavar="X Y Z", help="Centre of the bounding box."),
    ] = (0.0, 0.0, 300.0),
    turn_deg: Annotated[
        float,
        typer.Option(
            "--turn-deg",
            metavar="DEG",
            help="Turn about the vertical through the centre; positive brings +x nearer.",
        ),
    ] = 0.0,
    joints: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--joints",
            metavar="JOINTS.json",
            help="Write the 25 joints, too: name: [x, y, z], metres, in the frame of the mesh.",
        ),
    ] = None,
    rig: RigOption = None,
    mapping: MappingOption = None,
    rig_unit: RigUnitOption = None,
    rig_hand: RigHandOption = None,
    betas: BetasOption = None,
    theta: ThetaOption = None,
    list_poses: Annotated[bool, typer.Option("--list", help="List the poses and exit.")] = False,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """The mesh is closed, in metres and in the antenna frame, palm to the radar. A .glb file
    keeps palm, thumb, index, middle, ring and pinky apart, so that each can have its own alpha.

    With --rig, a hand of one's own is posed: where it stands in its file, in which unit, and
    which hand it is follow from its joints.
    """
    from clradar.hand import POSES, HandShape, hand_mesh, pose_by_name, read_pose

    if list_poses:
        print_table(("pose", "description"), [(n, pose.description) for n, pose in POSES.items()])
        return
    if output is None:
        raise wrong_usage("-o", "expected a mesh file to write, or --list")
    check_mesh_name(output)
    rig_options = {
        "--mapping": mapping, "--rig-unit": rig_unit, "--rig-hand": rig_hand,
        "--betas": betas, "--theta": theta,
    }  # fmt: skip
    shape_options = {
        "--length-mm": length_mm, "--breadth-mm": breadth_mm,
        "--finger-lengths": finger_lengths, "--girth": girth,
    }  # fmt: skip
    given = [name for name, value in shape_options.items() if value is not None]
    if rig is None:
        check_alone(rig_options)
    elif left:
        raise wrong_usage("--left", "a rig is a left or a right hand itself; see --rig-hand")
    elif edge_mm is not None:
        raise wrong_usage("--edge-mm", "a rig's mesh is taken as it is")
    elif device is not None:
        raise wrong_usage("--device", "a rig's mesh is posed without one")
    elif given:
        raise wrong_usage(given[0], "a rig has the size and shape of its own mesh")
    if theta is not None and pose is not None:
        raise wrong_usage("--theta", f"expected instead of a pose, got '{pose}', too")
    inputs = [path for path in (rig, mapping, theta) if path is not None]
    check_outputs([output, joints], force=force, inputs=inputs)
    pose = "F" if pose is None else pose
    # A name without a suffix is no file, even where one of that name lies about.
    posed = read_pose(pose) if Path(pose).suffix else pose_by_name(pose)
    center_m = [value / 1e3 for value in center_mm]
    if rig is None:
        average = HandShape()
        shape = HandShape(
            length_m=average.length_m if length_mm is None else length_mm / 1e3,
            breadth_m=average.breadth_m if breadth_mm is None else breadth_mm / 1e3,
            finger_lengths=finger_lengths or average.finger_lengths,
            girth=average.girth if girth is None else girth,
        )
        mesh = hand_mesh(
            posed,
            edge_length_m=(EDGE_MM if edge_mm is None else edge_mm) / 1e3,
            handedness="left" if left else "right",
            center_m=center_m,
            shape=shape,
            device=device,
        )
        what = f"hand '{posed.name}'"
    else:
        opened = opened_rig(rig, mapping, rig_unit, rig_hand, betas)
        mesh = posed_rig(opened, posed, theta, center_m)
        shown = f"theta of {theta}" if theta is not None else f"'{pose}'"
        what = f"{rig}: {described(opened)}, {shown}"
    if not np.isfinite(turn_deg):
        raise wrong_usage("--turn-deg", f"expected an angle in degrees, got {turn_deg:g}")
    mesh = turned(mesh, turn_deg, center_m)
    save_hand(output, mesh, force=force)
    if joints is not None:
        from clradar.cli.regions_file import joints_record

        write_json(joints, joints_record(mesh.joints_m), force=force)
    print_line(f"{output}: {what}, {len(mesh.faces)} faces")


def check_mesh_name(path: Path) -> None:
    """Raise unless a mesh can be written under this name."""
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(
            f"{path}: expected a name that ends in {', '.join(SUFFIXES)}, got '{path.suffix}'"
        )


def turned(mesh: HandMesh, angle_deg: float, center_m: Sequence[float]) -> HandMesh:
    """Return a hand turned about the vertical through `center_m`.

    Parameters
    ----------
    mesh : HandMesh
    angle_deg : float, degrees
        Positive brings what is at +x nearer to the radar.
    center_m : sequence of 3 floats, metres
    """
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    centre_m = np.asarray(center_m, dtype=np.float64)
    vertices_m = (mesh.vertices_m - centre_m) @ matrix.T + centre_m
    joints_m = (mesh.joints_m - centre_m) @ matrix.T + centre_m
    return replace(mesh, vertices_m=vertices_m, joints_m=joints_m)


def save_hand(path: Path, mesh: HandMesh, *, force: bool) -> None:
    """Write a hand's mesh whole or not at all, in metres."""
    import trimesh

    kind = path.suffix.lower()[1:]
    if kind == "glb":
        scene = trimesh.Scene()
        for i, name in enumerate(mesh.part_names):
            piece = trimesh.Trimesh(mesh.vertices_m, mesh.faces[mesh.part == i], process=False)
            piece.remove_unreferenced_vertices()
            scene.add_geometry(piece, node_name=name, geom_name=name)
        content = scene.export(file_type=kind)
    else:
        content = mesh.to_trimesh().export(file_type=kind)
    write_bytes(path, content.encode() if isinstance(content, str) else content, force=force)

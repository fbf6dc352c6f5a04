"""``clradar hand``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import numpy as np
import typer

from clradar.cli.options import ForceOption, wrong_usage
from clradar.cli.output import check_outputs, print_line, print_table, write_bytes, write_json
from clradar.errors import OutputError

if TYPE_CHECKING:
    from clradar.hand import HandMesh

SUFFIXES = (".ply", ".stl", ".obj", ".off", ".glb")
"""What is written; only .glb keeps the parts apart."""

EDGE_MM = 1.7


def command(
    pose: Annotated[
        str,
        typer.Argument(help="Name of a pose (--list shows them), or a pose file: .toml or .json."),
    ] = "F",
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", help=f"Mesh file: {', '.join(SUFFIXES)}."),
    ] = None,
    edge_mm: Annotated[
        float, typer.Option("--edge-mm", metavar="MM", help="About the length of an edge.")
    ] = EDGE_MM,
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
        tuple[float, float, float, float, float],
        typer.Option(
            "--finger-lengths",
            metavar="T I M R P",
            help="Thumb to little finger, relative to an average hand of this length.",
        ),
    ] = (1.0, 1.0, 1.0, 1.0, 1.0),
    girth: Annotated[
        float,
        typer.Option(
            "--girth", help="Thickness, relative to that of an average hand of this breadth."
        ),
    ] = 1.0,
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
    list_poses: Annotated[bool, typer.Option("--list", help="List the poses and exit.")] = False,
    force: ForceOption = False,
) -> None:
    """The mesh is closed, in metres and in the antenna frame, palm to the radar. A .glb file
    keeps palm, thumb, index, middle, ring and pinky apart, so that each can have its own alpha.
    """
    from clradar.hand import POSES, HandShape, hand_mesh, pose_by_name, read_pose

    if list_poses:
        print_table(("pose", "description"), [(n, pose.description) for n, pose in POSES.items()])
        return
    if output is None:
        raise wrong_usage("-o", "expected a mesh file to write, or --list")
    check_mesh_name(output)
    check_outputs([output, joints], force=force)
    sizes_mm = {"length_m": length_mm, "breadth_m": breadth_mm}
    sizes_m = {name: value / 1e3 for name, value in sizes_mm.items() if value is not None}
    shape = HandShape(finger_lengths=finger_lengths, girth=girth, **sizes_m)
    # A name without a suffix is no file, even where one of that name lies about.
    posed = read_pose(pose) if Path(pose).suffix else pose_by_name(pose)
    mesh = hand_mesh(
        posed,
        edge_length_m=edge_mm / 1e3,
        handedness="left" if left else "right",
        center_m=[value / 1e3 for value in center_mm],
        shape=shape,
    )
    mesh = turned(mesh, turn_deg, [value / 1e3 for value in center_mm])
    save_hand(output, mesh, force=force)
    if joints is not None:
        from clradar.cli.regions_file import joints_record

        write_json(joints, joints_record(mesh.joints_m), force=force)
    print_line(f"{output}: hand '{posed.name}', {len(mesh.faces)} faces")


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

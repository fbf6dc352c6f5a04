"""``clradar hand``: write the mesh of a posed hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from clradar.cli.console import print_line, print_table
from clradar.cli.options.common import DEVICE, FORCE
from clradar.cli.options.groups import argument, option, output_option, wrong_usage
from clradar.cli.options.hand import EmbeddedHandOptions, MovementOptions, RigOptions
from clradar.cli.options.sweep import joints_record
from clradar.cli.outputs import MESHES, check_outputs, check_suffix, save_mesh, turned
from clradar.files.json_file import write_json
from clradar.jobs import open_devices


@dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """Pose and position of the hand."""

    pose: str | None = argument(
        "Name of the pose (--list shows them), or a pose file (.toml, .json). [default: F]"
    )
    center_mm: tuple[float, float, float] = option(
        "Centre of the bounding box.", (0.0, 0.0, 300.0), metavar="X Y Z"
    )
    turn_deg: float = option(
        "Turn about the vertical through the centre; positive brings +x nearer.", 0.0
    )

    @property
    def name(self) -> str:
        """The name of the pose, or of its file."""
        return "F" if self.pose is None else self.pose


def command(
    *,
    pose: PoseOptions,
    movement: MovementOptions,
    output: Path | None = output_option(
        "Mesh file: .ply, .stl, .obj, .off, .glb; with --from a motion file, .toml."
    ),
    embedded: EmbeddedHandOptions,
    joints: Path | None = option(
        "Write the 25 joints, too: name: [x, y, z], metres, in the frame of the mesh.",
        metavar="JOINTS.json",
        panel="Output",
    ),
    rigged: RigOptions,
    list_poses: bool = option("List the poses and exit.", False, names=("--list",)),
    device: str | None = DEVICE,
    force: bool = FORCE,
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
        raise wrong_usage("-o", "expected a mesh file to write, or --list")
    check_suffix(output, (".toml",) if movement.poses else MESHES)
    if not abs(pose.turn_deg) <= 360.0:
        text = f"expected an angle from -360 to 360 degrees, got {pose.turn_deg:g}"
        raise wrong_usage("--turn-deg", text)
    # A name without a suffix is no file, even if there is one of that name.
    files = [Path(pose.name)] if Path(pose.name).suffix else []
    inputs = [*files, *movement.files, *rigged.files]
    check_outputs([output, joints], force=force, inputs=inputs)
    if movement.poses:
        movement.write_motion(output, embedded, rigged, pose.center_mm, pose.turn_deg, force=force)
        ends = " to ".join(f"'{end}'" for end in movement.poses)
        print_line(f"{output}: hand from {ends} in {movement.duration_s:g} s")
        return
    joint_angles, center_m = pose_of(pose.name), [value / 1e3 for value in pose.center_mm]
    if rigged.rig is None:
        mesh = embedded.posed(joint_angles, center_m, open_devices(device).first)
        text = f"hand '{joint_angles.name}'"
    else:
        mesh, text = rigged.posed(joint_angles, pose.name, center_m)
    mesh = turned(mesh, pose.turn_deg, center_m)
    save_mesh(output, mesh, force=force)
    if joints is not None:
        write_json(joints, joints_record(mesh.joints_m), force=force)
    print_line(f"{output}: {text}, {len(mesh.faces)} faces")

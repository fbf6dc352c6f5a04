"""Posed hands, one as a mesh or many as training data: ``hand`` and ``dataset``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli import console, options as opt, outputs as out, parse
from clradar.errors import ClradarError
from clradar.files.failures import fail
from clradar.files.json_file import indented, read_json
from clradar.files.toml_file import toml_document
from clradar.jobs import open_devices
from clradar.model import checks


def _pose_file(pose: str) -> list[Path]:
    """The pose file: a name without a suffix is none, even if there is one of that name."""
    return [Path(pose)] if Path(pose).suffix else []


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
        return "left" if self.left else "right"

    def rigged(
        self, pose: cl.hand.HandPose, name: str, center_m: Sequence[float]
    ) -> tuple[cl.hand.HandMesh, str]:
        """The rig's surface in a pose, or at a theta of MANO; and a description of both."""
        rig = self.read_rig()
        if self.theta is None:
            mesh, shown = rig.posed(pose, center_m), f"'{name}'"
        else:
            values = read_json(self.theta, expected := "a JSON list of 48 numbers")
            if not isinstance(values, list) or not all(type(v) in (int, float) for v in values):
                fail(self.theta, expected, "something else")
            if len(values) != 48:
                fail(self.theta, expected, f"{len(values)}")
            rotations = cl.rigs.rotations_of_theta(rig, values)
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
        shape = self.shape or cl.hand.HandShape()
        keys = {
            "handedness": self.handedness, "length_mm": 1e3 * shape.length_m,
            "breadth_mm": 1e3 * shape.breadth_m, "girth": shape.girth,
            "finger_lengths": shape.finger_lengths,
        }  # fmt: skip
        return keys if self.edge_mm is None else {**keys, "edge_mm": self.edge_mm}


def hand_command(
    *,
    pose: str | None = opt.argument(
        "Name of the pose (--list shows them), or a pose file (.toml, .json). [default: F]",
        metavar="POSE",
        files=_pose_file,
    ),
    center_mm: tuple[float, float, float] = opt.option(
        "Centre of the bounding box.", (0.0, 0.0, 300.0), metavar="X Y Z"
    ),
    turn_deg: float = opt.option(
        "Turn about the vertical through the centre; positive brings +x nearer.",
        0.0,
        check=partial(checks.within, low=-360, high=360, unit=" deg"),
    ),
    start: str | None = opt.option(
        "Go from this pose to that of --to: -o is a motion file (.toml) for `clradar simulate`.",
        None,
        "--from",
        metavar="POSE",
        needs="--to",
        without="POSE --joints",
        files=_pose_file,
    ),
    end: str | None = opt.option(
        "The last pose.", None, "--to", metavar="POSE", needs="--from", files=_pose_file
    ),
    duration_s: float = opt.option(
        "Time from pose to pose.", 1.0, needs="--from", check=checks.positive
    ),
    output: Path | None = opt.output_option(
        "Mesh file: .ply, .stl, .obj, .off; with --from a motion file, .toml."
    ),
    surface: SurfaceOptions,
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
    from calibration.hand_fit.result import by_joint
    from clradar.hand.pose_file import pose_of

    if list_poses:
        console.table(
            ("pose", "description"), [(n, known.description) for n, known in cl.hand.POSES.items()]
        )
        return
    if output is None:
        raise opt.wrong_usage("-o", "expected a mesh file to write, or --list")
    parse.ends_in(*((".toml",) if start is not None else out.MESHES))("-o", output)
    if start is not None:
        folder = output.parent
        hand = {"center_mm": center_mm, **surface.motion_keys(folder)}
        text = "[[hand]]\n" + toml_document(hand)
        if turn_deg:
            text += f"about_mm = {list(center_mm)}\n[[hand.place]]\ntime_s = 0.0\n"
            text += f"turn_deg = [0.0, {turn_deg!r}, 0.0]\n"
        for time_s, name in ((0.0, start), (duration_s, str(end))):
            pose_of(name)  # raises where there is none
            named = os.path.relpath(name, folder) if Path(name).suffix else name
            text += "[[hand.pose]]\n" + toml_document({"time_s": time_s, "pose": named})
        ends = f"'{start}' to '{end}'"
        out.write(output, text, f"hand from {ends} in {duration_s:g} s")
        return
    name, center_m = pose or "F", opt.scaled(center_mm, 1e3)
    angles = pose_of(name)
    if surface.rig is None:
        edge_mm = 1.7 if surface.edge_mm is None else surface.edge_mm
        mesh = cl.hand.hand_mesh(
            angles, edge_length_m=edge_mm / 1e3, handedness=surface.handedness, center_m=center_m,
            shape=surface.shape or cl.hand.HandShape(), device=open_devices(device).first,
        )  # fmt: skip
        text = f"hand '{angles.name}'"
    else:
        mesh, text = surface.rigged(angles, name, center_m)
    mesh = out.turned(mesh, turn_deg, center_m)
    out.write(joints, indented(by_joint(mesh.joints_m)))
    out.write(output, mesh, f"{text}, {len(mesh.faces)} faces")


def dataset_command(
    *,
    plan: Path | None = opt.argument(
        "The plan of the data set, see docs/datasets.md.", metavar="PLAN.toml"
    ),
    output: Path | None = opt.output_option("Folder of the data set.", folder=True),
    schema: bool = opt.option("Print the JSON schema of plans, for editors, and end.", False),
    dry_run: bool = opt.option(
        "Make one sample, estimate time and space of all, write none.", False
    ),
    replay: tuple[Path, int] | None = opt.option(
        "Make sample N of a data set again and compare it with the stored one, bit by bit.",
        metavar="DIR N",
        without="PLAN.toml --dry-run -o",
    ),
    rigs: Path | None = opt.option(
        "Folder of the plan's rig files. [default: the current folder]",
        metavar="FOLDER",
        needs="--replay",
    ),
    processes: opt.WorkerOptions,
    retry: bool = opt.option("Try the samples again that were set aside.", False),
    device: str | None = opt.DEVICE,
    force: bool = opt.option(
        "Remove the data set that is in the folder, of this plan or another, and begin anew.",
        False,
        panel="Output",
    ),
) -> None:
    """The same command again resumes where it stopped. A sample that cannot be made is set aside;
    the exit status is 1 as long as any is.
    """
    from clradar.dataset.plan.plan import read_plan
    from clradar.dataset.runs import estimate, replay as make_again

    if schema:
        console.text(json.dumps(cl.dataset.plan_schema(), indent=1))
        return
    if replay is not None:
        selector = open_devices(device).infos[0].selector
        with console.bar("making the sample"):
            found = make_again(*replay, device=selector, rigs=rigs or "")
        index, shown = replay[1], f"in {replay[0] / found.stored_in}"
        if not found.differences:
            console.line(f"sample {index}: the same bits as {shown}")
        else:
            for line in found.made_otherwise:
                console.warning(f"made otherwise then: {line}")
            console.text("\n".join(found.differences))
            count = console.counted(len(found.differences), "difference")
            raise ClradarError(f"sample {index}: {count} to that {shown}")
        return
    if plan is None:
        raise opt.wrong_usage("PLAN.toml", "expected a plan, or --replay DIR N")
    wanted = read_plan(plan)
    if dry_run:
        with console.bar("making two samples"):
            _, _, lines = estimate(wanted, device=open_devices(device).infos[0].selector)
        console.text("\n".join(lines))
        return
    if output is None:
        raise opt.wrong_usage("-o", "expected the folder of the data set, or --dry-run")
    out.check_folder(output, resumed=True)
    where = processes.where(device)
    with console.bar("samples") as progress:
        result = cl.dataset.run(
            wanted, output, where=where, force=force, retry=retry, progress=progress
        )
    there = f"{result.samples - len(result.aside)} of {result.samples} samples"
    console.line(f"{output}: {there}, {result.made} of them made now")
    if result.aside:
        count = console.counted(len(result.aside), "sample")
        raise ClradarError(f"{output}: {count} set aside; --retry tries again")

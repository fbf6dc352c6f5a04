"""A hand on its way from one pose to another: as a motion file, or as meshes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.options.groups import given, option
from clradar.cli.options.hand import EmbeddedHandOptions
from clradar.cli.options.rig import RigFileOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import whole_folder
from clradar.files.atomic import write_file
from clradar.files.toml_file import toml_document

if TYPE_CHECKING:
    from clradar.hand import HandMesh
    from clradar.model.progress import Progress
    from clradar.motion.hands import MovingHand

MAX_STEPS = 10_000


@dataclass(frozen=True, kw_only=True)
class WayOptions:
    """From one pose to another."""

    start: str | None = option(
        None,
        "Go from this pose to that of --to, from rest to rest: with -o MOTION.toml as a motion for "
        "`clradar simulate --motion`, with -o FOLDER as meshes and poses.",
        metavar="POSE",
        names=("--from",),
    )
    end: str | None = option(None, "The last pose.", metavar="POSE", names=("--to",))
    duration_s: float = option(1.0, "Time from pose to pose.", metavar="S")
    steps: int = option(10, "Meshes, at equal times, the first and the last pose too.", metavar="N")

    def __post_init__(self) -> None:
        if (self.start is None) != (self.end is None):
            raise wrong_usage("--from", "expected together with --to")
        if self.start is None:
            for name in given(self):
                raise wrong_usage(name, "expected together with --from and --to")
        if not 0 < self.duration_s < float("inf"):
            raise wrong_usage("--duration-s", f"expected a positive time, got {self.duration_s:g}")
        if not 2 <= self.steps <= MAX_STEPS:
            raise wrong_usage("--steps", f"expected 2 to {MAX_STEPS}, got {self.steps}")

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

    def write_meshes(
        self,
        folder: Path,
        hand: MovingHand,
        turned: Callable[[HandMesh], HandMesh],
        progress: Progress | None,
        *,
        force: bool,
    ) -> None:
        """Write `000000.ply`, and its pose `000000.toml`, and so on: whole or not at all."""
        from clradar.cli.hand_mesh import save_hand
        from clradar.hand import write_pose

        with whole_folder(folder, force=force, replaced=replaced_in(folder)) as made:
            for i in range(self.steps):
                time_s = self.duration_s * i / (self.steps - 1)
                save_hand(made / f"{i:06d}.ply", turned(hand.mesh(time_s)), force=False)
                write_pose(made / f"{i:06d}.toml", hand.pose(time_s))
                if progress is not None:
                    progress(i + 1, self.steps)


def replaced_in(folder: Path) -> list[str]:
    """What `WayOptions.write_meshes` replaces in a folder."""
    return [path.name for end in ("ply", "toml") for path in folder.glob(f"[0-9]*.{end}")]


def _named(pose: str, motion: Path) -> str:
    """A pose as a motion file names it: files relative to it."""
    return os.path.relpath(pose, motion.parent) if Path(pose).suffix else pose

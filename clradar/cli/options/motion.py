"""Options of movement: how a scene moves, and the frames that are recorded of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.cli.options.groups import given, option
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_folder, check_outputs

if TYPE_CHECKING:
    from clradar.motion.motion_file import Motion

TRUTH = "truth"
"""Folder beside the frames with what a recording was made of."""

CLUSTER_NAME = "cluster_{:03d}"
"""Capture or recording of one cluster, in the folder of all."""

MAX_FRAMES = 10_000


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """Movement, and frames of it."""

    motion: Path | None = option(
        None,
        "How meshes and hands move, and when the imager records each sample (docs/movement.md).",
        metavar="MOTION.toml",
    )
    frames: int | None = option(
        None, "Make a recording of so many frames, instead of one capture.", metavar="N"
    )
    rate_hz: float = option(8.0, "Frames per second; the first begins at time 0.", metavar="HZ")

    def __post_init__(self) -> None:
        if self.motion is None:
            for name in given(self):
                raise wrong_usage(name, "expected together with --motion")
        if self.frames is not None and not 1 <= self.frames <= MAX_FRAMES:
            raise wrong_usage("--frames", f"expected 1 to {MAX_FRAMES}, got {self.frames}")
        if not 0 < self.rate_hz < float("inf"):
            raise wrong_usage("--rate-hz", f"expected a positive number, got {self.rate_hz:g}")

    def read(self) -> Motion | None:
        """What the motion file says."""
        from clradar.motion.motion_file import read_motion

        return None if self.motion is None else read_motion(self.motion)

    def check(self, output: Path, *, several: bool, force: bool, inputs: Iterable[Path]) -> None:
        """Raise unless the capture, the recording or those of several clusters may be written."""
        if self.frames is None and not several:
            check_outputs([output], force=force, inputs=inputs)
        else:
            check_folder(output, force=force, replaced=replaced_in(output), inputs=inputs)


def replaced_in(folder: Path) -> list[str]:
    """What a recording of this command replaces in a folder."""
    found = [*folder.glob("radar_*"), *folder.glob("cluster_*")]
    return [TRUTH, *(path.name for path in found)]

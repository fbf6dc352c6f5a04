"""Options of the mean over the frames of recordings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.cli.inputs import mean_capture
from clradar.cli.options.groups import option
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.values import wrong_usage

if TYPE_CHECKING:
    from clradar import Capture


@dataclass(frozen=True, kw_only=True)
class AverageOptions:
    """The mean over the frames of recordings."""

    average: bool = option(False, "Take the coherent mean of all frames of each radar folder.")
    align_phase: bool = option(False, "With --average: first rotate frames to a common phase.")

    def check(self, frames: FrameOptions, sources: list[Path], names: str) -> None:
        """Raise unless the options go together."""
        if self.align_phase and not self.average:
            raise wrong_usage("--align-phase", "expected --average with it")
        if self.average and frames.frame is not None:
            raise wrong_usage("--frame", "expected either --frame or --average")
        if self.average and not any(path.is_dir() for path in sources):
            raise wrong_usage("--average", f"expected a radar folder among {names}")

    def read(self, path: Path, frames: FrameOptions) -> tuple[Capture, list[Path], str]:
        """One frame or the mean of all, the files it comes from, and the mean in words."""
        if self.average and path.is_dir():
            mean, files = mean_capture(
                path, variant=frames.chosen["variant"], align_phase=self.align_phase
            )
            count = mean.meta["average"]["frames"]
            return mean, files, "1 frame" if count == 1 else f"mean of {count} frames"
        return *frames.open(path), ""

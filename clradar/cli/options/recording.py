"""Options that choose a frame of a recording, and the positions of its antennas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.options.groups import option, recorded

if TYPE_CHECKING:
    from clradar import Capture

Variant = Literal["raw", "emptyfiltered"]


def recording_files(path: Path, capture_meta: Mapping[str, Any]) -> list[Path]:
    """The files whose content a capture comes from: the frame's, if `path` is a folder."""
    if not path.is_dir():
        return [path]
    source = capture_meta.get("source")
    frame = Path(source) if isinstance(source, str) else None
    return [frame] if frame is not None and frame.is_file() else []


@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """Which frame of a recording."""

    frame: int | None = option(None, "Frame of a recording. [default: 0]", metavar="N")
    variant: Variant | None = option(None, "Variant of a recording's frame. [default: raw]")

    @property
    def chosen(self) -> dict[str, Any]:
        """`frame` and `variant` as `measurement_io.open_capture` takes them."""
        return recorded(self)

    def open(self, path: Path) -> tuple[Capture, list[Path]]:
        """The capture of a file or folder, and the files whose content it is."""
        from measurement_io import open_capture

        capture = open_capture(path, **self.chosen)
        return capture, recording_files(path, capture.meta)


@dataclass(frozen=True, kw_only=True)
class AntennaOptions:
    """Files with the positions of antennas."""

    rx_file: Path | None = option(None, "Positions of the Rx antennas of a recorded frame.")
    tx_file: Path | None = option(None, "Positions of the Tx antennas of a recorded frame.")

    @property
    def files(self) -> list[Path]:
        """The files that were given."""
        return [path for path in (self.rx_file, self.tx_file) if path is not None]

    @property
    def chosen(self) -> dict[str, Any]:
        """`rx_file` and `tx_file` as `measurement_io.open_recording` takes them."""
        return {"rx_file": self.rx_file, "tx_file": self.tx_file}

"""Captures and volumes that commands read, and images of the captures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.options.groups import given
from clradar.cli.options.imaging import MODEL_METHODS, GridOptions, ImagingOptions
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.recording import FrameOptions, recording_files
from clradar.cli.options.values import wrong_usage

if TYPE_CHECKING:
    from clradar import Capture, Device, Volume, VoxelGrid


def form_image(
    capture: Capture,
    grid: VoxelGrid,
    imaging: ImagingOptions,
    device: Device | str | None,
    label: str,
    tolerance_db: float | None = None,
) -> Volume:
    """The image of a capture, with a progress bar on a terminal."""
    from clradar import backproject, reconstruct

    form = reconstruct if imaging.method in MODEL_METHODS else backproject
    with progress_bar(label) as progress:
        return form(
            capture, grid, tolerance_db=tolerance_db, device=device, progress=progress,
            **imaging.arguments,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ImageInput:
    """A volume, or a capture that is still to be imaged, and where it comes from."""

    path: Path
    content: Volume | Capture

    @classmethod
    def open(cls, path: Path, frames: FrameOptions | None = None) -> ImageInput:
        """Open a file or a folder; a frame can be chosen of a recording only."""
        from measurement_io import open_capture, open_volume
        from measurement_io.native.captures_volumes import read_header
        from measurement_io.opening import kind_of

        frames = frames or FrameOptions()
        native = frames == FrameOptions() and kind_of(path) == "native"
        if native and read_header(path).format == "volume":
            return cls(path, open_volume(path))
        return cls(path, open_capture(path, **frames.chosen))

    @property
    def grid(self) -> VoxelGrid | None:
        """The voxel grid of a volume; None for a capture."""
        from clradar import Volume

        return self.content.grid if isinstance(self.content, Volume) else None

    @property
    def radar(self) -> dict[str, Any]:
        """`array` and `waveform` of a capture, as keyword arguments; none for a volume."""
        from clradar import Volume

        if isinstance(self.content, Volume):
            return {}
        return {"array": self.content.array, "waveform": self.content.waveform}

    def radar_or(self, options: RadarOptions) -> dict[str, Any]:
        """`array` and `waveform` of a capture; of a volume, which has none, of the options."""
        if not self.radar:
            return {"array": options.antennas(), "waveform": options.waveform()}
        if given(options):
            text = f"{self.path} is a capture and has its antennas and frequencies"
            raise wrong_usage(", ".join(given(options)), text)
        return self.radar

    @property
    def files(self) -> list[Path]:
        """The files whose content this is."""
        return recording_files(self.path, self.content.meta)

    def volume(
        self, grid: VoxelGrid, imaging: ImagingOptions, device: Device | str | None
    ) -> Volume:
        """The volume, or the image of the capture on `grid`."""
        from clradar import Volume

        if isinstance(self.content, Volume):
            return self.content
        return form_image(self.content, grid, imaging, device, f"imaging {self.path.name}")


def grid_for(
    capture: Capture,
    options: GridOptions,
    device: Device | str | None = None,
    *,
    everything: bool = False,
) -> VoxelGrid:
    """The grid of the options; without them one that shows what is in the capture, and say which.

    `everything` is that of `clradar.place_grid`.
    """
    from clradar import open_device
    from clradar.imaging.placement import placement, placement_words

    if given(options):
        return options.grid()
    placed = placement(capture, open_device(device), everything=everything)
    if placed.shown:
        print_line(f"no grid given: {placement_words(capture, placed)}")
    return placed.grid


def common_grid(
    options: GridOptions, *images: ImageInput, device: Device | str | None = None
) -> VoxelGrid:
    """The grid of the options; without them that of the first volume, or for the first capture."""
    from clradar import Capture

    if not given(options):
        for image in images:
            if image.grid is not None:
                return image.grid
    captures = [image.content for image in images if isinstance(image.content, Capture)]
    return grid_for(captures[0], options, device) if captures else options.grid()


def mean_capture(
    path: Path, *, variant: str | None = None, align_phase: bool = False
) -> tuple[Capture, list[Path]]:
    """The coherent mean of all frames of a recording, and their files.

    Missing frames are left out; a warning says how many the recording should have.
    """
    from calibration import average_frames
    from clradar.files.failures import fail
    from measurement_io import open_recording

    chosen = variant or "raw"
    recording = open_recording(path, variant=chosen)
    if not len(recording):
        fail(path, f"frames of variant {chosen}", "none")
    files: list[Path] = []

    with progress_bar("averaging") as progress:

        def frames() -> Iterator[Capture]:
            for capture in recording:
                files.extend(recording_files(path, capture.meta))
                yield capture
                if progress is not None:
                    progress(len(files), len(recording))

        mean = average_frames(frames(), align_phase=align_phase)
    expected = mean.meta.get("number_of_measurements")
    if isinstance(expected, int) and expected != len(recording):
        print_warning(f"{path}: {len(recording)} of {expected} frames are there; averaged those")
    return mean, files

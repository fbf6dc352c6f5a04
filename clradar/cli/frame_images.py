"""Images of the frames of a recording, and thin pictures of them that are kept for a sheet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.inputs import form_image
from clradar.cli.options.groups import given
from clradar.cli.options.imaging import GridOptions, ImagingOptions
from clradar.cli.resumable import FolderStore
from clradar.errors import CompareError

if TYPE_CHECKING:
    from calibration.hand_fit.movement_figure import Picture
    from clradar import Capture, DepthMap, Volume
    from measurement_io import Recording

SHEET_PIXEL_M = 2e-3


@dataclass(frozen=True, slots=True)
class FrameImages(Sequence["Volume"]):
    """Images of the frames of a recording, formed on access; their maxima are kept in a store."""

    recording: Recording
    voxels: GridOptions
    imaging: ImagingOptions
    device: str | None
    store: FolderStore

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return self.recording.frame_numbers

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, index: Any) -> Any:
        from clradar import place_grid

        capture: Capture = self.recording[index]
        grid = self.voxels.grid() if given(self.voxels) else place_grid(capture, device=self.device)
        volume = form_image(capture, grid, self.imaging, self.device, "imaging")
        keep_picture(self.store, self.frame_numbers[index], volume)
        return volume


@dataclass(frozen=True, slots=True)
class KeptImages(Sequence["DepthMap"]):
    """Depth maps of frames, read on access; their maxima are kept in a store.

    Attributes
    ----------
    frame_numbers : tuple of int
    times_us : tuple of float or None
        Their time stamps, as far as they have any.
    read : callable
        The depth map of a frame, by its number.
    store : FolderStore
    """

    frame_numbers: tuple[int, ...]
    times_us: tuple[float | None, ...]
    read: Callable[[int], DepthMap]
    store: FolderStore

    def __len__(self) -> int:
        return len(self.frame_numbers)

    def time_us(self, index: int) -> float | None:
        """The time stamp of a frame, which depth maps do not have."""
        return self.times_us[index]

    def __getitem__(self, index: Any) -> Any:
        number = self.frame_numbers[index]
        seen = self.read(number)
        keep_picture(self.store, number, seen)
        return seen


def keep_picture(store: FolderStore, number: int, image: Volume | DepthMap) -> None:
    """Keep a thin picture of a frame's maxima, if there is anything above zero."""
    from clradar.compare import depth_map_of
    from clradar.constants import DYNAMIC_RANGE_DB

    try:
        seen = depth_map_of(image, DYNAMIC_RANGE_DB, "image")
    except CompareError:
        return
    thin = slice(None, None, max(1, round(SHEET_PIXEL_M / float(seen.x_m[1] - seen.x_m[0]))))
    amplitude = seen.amplitude[thin, thin] / seen.amplitude.max()
    store[f"{number:06d}"] = {
        "amplitude": amplitude.astype(np.float32), "x_m": seen.x_m[thin], "y_m": seen.y_m[thin],
    }  # fmt: skip


def picture_of(store: FolderStore, number: int) -> Picture | None:
    """The picture of a frame; None where it could not be imaged."""
    name = f"{number:06d}"
    if name not in store:
        return None
    arrays = store[name]
    return arrays["amplitude"], arrays["x_m"], arrays["y_m"]

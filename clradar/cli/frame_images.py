"""Images of the frames of a recording, and thin pictures of them that are kept for a sheet."""

from __future__ import annotations

from collections.abc import Sequence
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
    from clradar import Capture, Volume
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
        from clradar.compare import depth_map_of
        from clradar.constants import DYNAMIC_RANGE_DB

        capture: Capture = self.recording[index]
        grid = self.voxels.grid() if given(self.voxels) else place_grid(capture, device=self.device)
        volume = form_image(capture, grid, self.imaging, self.device, "imaging")
        number = self.frame_numbers[index]
        try:
            seen = depth_map_of(volume, DYNAMIC_RANGE_DB, "image")
        except CompareError:
            return volume
        thin = slice(None, None, max(1, round(SHEET_PIXEL_M / float(grid.spacing_m[0]))))
        amplitude = seen.amplitude[thin, thin] / seen.amplitude.max()
        self.store[f"{number:06d}"] = {
            "amplitude": amplitude.astype(np.float32), "x_m": seen.x_m[thin], "y_m": seen.y_m[thin],
        }  # fmt: skip
        return volume


def picture_of(store: FolderStore, number: int) -> Picture | None:
    """The picture of a frame; None where it could not be imaged."""
    name = f"{number:06d}"
    if name not in store:
        return None
    arrays = store[name]
    return arrays["amplitude"], arrays["x_m"], arrays["y_m"]

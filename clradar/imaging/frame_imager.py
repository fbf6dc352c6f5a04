"""Images of frame after frame: what they share stays on the device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ModelError
from clradar.imaging import fast
from clradar.imaging.exact import ExactImager
from clradar.imaging.fast import FastSum, ResidentImage
from clradar.imaging.memory import BYTES_OF_ONE, check_memory
from clradar.imaging.range_profiles import RangeImager
from clradar.imaging.windows import frequency_weights
from clradar.model import (
    AntennaArray,
    Capture,
    DepthMap,
    ImageScale,
    Volume,
    VoxelGrid,
    Waveform,
    checks,
)
from clradar.model.progress import Progress
from clradar.model.volume import refined_depth_map
from clradar.opencl import Device, open_device

METHODS = ("exact", "range", "fast")
DEFAULT_METHOD = "fast"


def image_meta(
    method: str, window: str | np.ndarray, tolerance_db: float | None, device: Device
) -> dict[str, Any]:
    """Return what `Volume.meta` says of how an image was formed; arguments as of `backproject`."""
    accuracy = {}
    if method == "fast":
        accuracy["tolerance_db"] = fast.checked_tolerance_db("tolerance_db", tolerance_db)
    return {
        "kind": "image",
        "method": method,
        "window": window if isinstance(window, str) else "custom",
        **accuracy,
        "device": dict(device.describe()),
    }


class FrameImager:
    """Images of frame after frame, by one radar over one grid: each with the bits of `backproject`.

    What frames share is made once and stays on the device, as does the image; samples go there, and
    the depth map (28 bytes per pixel) or the volume comes back. The end of a ``with`` block, or
    `close`, frees the device's memory. Not for several threads at once.

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
    grid : VoxelGrid
    method, window, tolerance_db, device
        As of `backproject`. Images are kept in the host's memory with "exact" and "range", more
        than 2^23 voxels or 1024 transmitters or receivers, or with few voxels.

    Attributes
    ----------
    array, waveform, grid, device
    weights : ndarray, shape (n_freq,), float64
        The window over frequency.

    Examples
    --------
    A point reflector that moves away by 2 mm.

    >>> array = clradar.arrays.qar50().part(slice(None, None, 6), slice(None, None, 6))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.04, 0.04), (0.28, 0.32), 2e-3)
    >>> with clradar.FrameImager(array, waveform, grid, window="hann") as imager:
    ...     for z_m in (0.300, 0.302):
    ...         point_m = [[0.01, -0.02, z_m]]
    ...         imager.form(clradar.room_capture(array, waveform, [], points_m=point_m))
    ...         print(f"{np.nanmean(imager.depth_map(2.0).depth_m):.4f}")
    0.3000
    0.3020
    """

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        grid: VoxelGrid,
        *,
        method: str = DEFAULT_METHOD,
        window: str | np.ndarray = "rect",
        tolerance_db: float | None = None,
        device: Device | str | None = None,
    ) -> None:
        checks.one_of("method", method, METHODS)
        checks.instance("array", array, AntennaArray)
        checks.instance("waveform", waveform, Waveform)
        checks.instance("grid", grid, VoxelGrid)
        if tolerance_db is not None and method != "fast":
            checks.fail("tolerance_db", "none for a method other than 'fast'", repr(tolerance_db))
        tolerance_db = fast.checked_tolerance_db("tolerance_db", tolerance_db)
        check_memory(grid, BYTES_OF_ONE)
        self.array, self.waveform, self.grid = array, waveform, grid
        self.weights = frequency_weights(window, waveform.n_freq)
        self.device = open_device(device)
        self._method = method
        self._n_samples = array.n_tx * array.n_rx * waveform.n_freq
        self._meta = image_meta(method, window, tolerance_db, self.device)
        self._frame: Mapping[str, Any] | None = None
        """`meta` of the frame whose image it is."""
        self._capture: Capture | None = None
        """That frame, where it was formed of a capture."""
        self._data: np.ndarray | None = None
        self._sum: FastSum | None = None
        self._resident: ResidentImage | None = None
        if method == "fast" and np.prod(grid.shape) * self._n_samples > fast.FEW_TERMS:
            pieces = fast.grid_pieces(grid)
            self._sum = FastSum(array, waveform, pieces, tolerance_db, self.device, both_ways=False)
            if len(self._sum.parts) == len(pieces) == 1:
                self._resident = ResidentImage(self._sum, self.weights)
            else:
                self._sum.prepare()

    def __enter__(self) -> FrameImager:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()

    def close(self) -> None:
        """Free the device's memory; a second call does nothing."""
        if self._resident is not None:
            self._resident.close()
        self._frame = self._capture = self._data = None

    def form(self, capture: Capture, progress: Progress | None = None) -> None:
        """Form the image of a frame by the same antennas and frequencies."""
        checks.instance("FrameImager.form: capture", capture, Capture)
        same = capture.array.same_positions(self.array)
        if not (same and capture.waveform.same_frequencies(self.waveform)):
            checks.fail("FrameImager.form: capture", "one by its array and waveform", "another one")
        self._frame = self._capture = self._data = None
        if self._resident is not None:
            self._resident.form(capture.data, fast.reported(progress, fast.TILE_STEPS))
        elif self._sum is not None:
            self._data = np.zeros(self.grid.shape, dtype=np.complex64)
            total = fast.TILE_STEPS * len(self._sum.parts) * len(self._sum.pieces)
            report = fast.reported(progress, total)
            self._sum.adjoint(capture.data, self.weights, self._data, report)
        else:
            kind = RangeImager if self._method == "range" else ExactImager
            imager = kind(capture, self.grid, self.weights, self.device)
            self._data = imager.run(progress)
        self._frame, self._capture = capture.meta, capture

    def form_on_device(
        self, samples: Any, stride: int, meta: Mapping[str, Any], progress: Progress | None = None
    ) -> None:
        """Form the image of samples on this device, where it `keeps_image`.

        They are finite, complex64, shape (n_tx, n_rx, stride), of which the first n_freq count.

        :meta private:
        """
        assert self._resident is not None
        self._frame = self._capture = None
        self._resident.form_on_device(samples, stride, fast.reported(progress, fast.TILE_STEPS))
        self._frame = meta

    @property
    def keeps_image(self) -> bool:
        """Whether the image is kept on the device.

        :meta private:
        """
        return self._resident is not None

    def volume(self) -> Volume:
        """Return the image of the last frame."""
        frame = self._formed()
        data = self._data if self._resident is None else self._resident.read()
        assert data is not None
        if data.flags.writeable:  # not scaled yet
            data.view(np.float32)[...] /= self._n_samples
            data.flags.writeable = False
        absolute = frame.get("absolute") is True
        meta = {**self._meta, "capture": dict(frame)}
        array = self.array if self._capture is None else self._capture.array  # its gains
        scale = ImageScale(array, self.waveform, self.weights) if absolute else None
        try:
            return Volume(data, self.grid, meta, scale)
        except ModelError as error:
            raise self._overflow() from error

    def depth_map(self, dynamic_range_db: float = DYNAMIC_RANGE_DB) -> DepthMap:
        """Return `Volume.depth_map` of the last frame, whose volume stays on the device.

        Of voxels along z that are equally strong to the rounding of float32 either may be taken.
        """
        if self._resident is None:
            return self.volume().depth_map(dynamic_range_db)
        dynamic_range_db = checks.dynamic_range("depth_map: dynamic_range_db", dynamic_range_db)
        self._formed()
        found = self._resident.strongest()
        if (found.top < 0).any():
            raise self._overflow()
        before, peak, after = (np.abs(part) for part in (found.before, found.peak, found.after))
        return refined_depth_map(self.grid, found.top, (before, peak, after), dynamic_range_db)

    def _formed(self) -> Mapping[str, Any]:
        if self._frame is None:
            checks.fail("FrameImager", "a frame formed before its image is read", "none")
        return self._frame

    def _overflow(self) -> ModelError:
        # Finite samples, each of which complex64 holds, but not their sum.
        parts = ""
        if self._capture is not None:
            largest = float(np.abs(self._capture.data.view(np.float32)).max())
            parts = f" with parts of up to {largest:.3g}"
        return ModelError(
            f"image: expected samples whose sum complex64 holds, got an overflow{parts}; scale the "
            "capture's data down"
        )

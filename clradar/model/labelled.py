"""Records as xarray objects: arrays with their axes, units and provenance.

The modules of the records import this one, so their classes are not named here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.errors import MissingPackage
from clradar.files.json_file import to_json

if TYPE_CHECKING:
    import xarray

INSTALL = "pip install xarray"


def import_xarray(function: str) -> Any:
    """Return the module xarray; `MissingPackage`, which names `function`, where there is none."""
    try:
        import xarray
    except ImportError as error:
        raise MissingPackage(f"{function}: expected xarray, got {error}; {INSTALL}") from error
    return xarray


def capture_dataset(capture: Any) -> xarray.Dataset:
    """Return the samples of a capture along tx, rx and frequency_hz, named as in data sets."""
    xarray = import_xarray("Capture.to_xarray")
    array = capture.array
    coordinates: dict[str, Any] = {
        "tx": ("tx", np.arange(array.n_tx), {"long_name": "Tx antenna"}),
        "rx": ("rx", np.arange(array.n_rx), {"long_name": "Rx antenna"}),
        "frequency_hz": _axis("frequency_hz", capture.waveform.frequencies_hz, "frequency", "Hz"),
        "coordinate": ("coordinate", list("xyz")),
    }
    for side in ("tx", "rx"):
        about = {"long_name": f"{side.title()} antenna positions", "units": "m"}
        positions_m = getattr(array, f"{side}_m")
        coordinates[f"{side}_m"] = ((side, "coordinate"), positions_m, about)
    attributes = {"array_name": array.name, "provenance": to_json("Capture.meta", capture.meta)}
    samples = (("tx", "rx", "frequency_hz"), capture.data, {"long_name": "complex response"})
    return xarray.Dataset({"capture": samples}, coordinates, attributes)


def volume_array(volume: Any) -> xarray.DataArray:
    """Return the voxels of a volume along z_m, y_m and x_m."""
    xarray = import_xarray("Volume.to_xarray")
    dims = ("z_m", "y_m", "x_m")
    attributes = {"long_name": "complex image", "provenance": to_json("Volume.meta", volume.meta)}
    coordinates = _pixels(dims, volume.grid)
    return xarray.DataArray(volume.data, coordinates, dims, "volume", attributes)


def depth_dataset(depth: Any) -> xarray.Dataset:
    """Return depth and amplitude of a depth map along y_m and x_m."""
    xarray = import_xarray("DepthMap.to_xarray")
    dims = ("y_m", "x_m")
    about = {"long_name": "depth of the maximum; NaN: nothing", "units": "m"}
    variables = {
        "depth_m": (dims, depth.depth_m, about),
        "amplitude": (dims, depth.amplitude, {"long_name": "amplitude"}),
    }
    attributes = {"dynamic_range_db": depth.dynamic_range_db}
    return xarray.Dataset(variables, _pixels(dims, depth), attributes)


def _axis(name: str, values: np.ndarray, long_name: str, units: str) -> Any:
    return name, values, {"long_name": long_name, "units": units}


def _pixels(dims: tuple[str, ...], axes: Any) -> Mapping[str, Any]:
    """Return the axes of a grid or of an image, whose attributes they are."""
    return {name: _axis(name, getattr(axes, name), name[0], "m") for name in dims}

"""Native HDF5 files of captures, volumes and calibrated channels (docs/files.md)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ModelError
from clradar.files import json_file
from clradar.files.failures import clean, fail, reading
from clradar.model import (
    AntennaArray,
    AntennaPattern,
    Capture,
    ChannelCalibration,
    ChannelResponse,
    ImageScale,
    Volume,
    VoxelGrid,
    Waveform,
    checks,
)
from clradar.model.volume import Planes, depth_map_of_planes
from measurement_io.confined import reading as confined
from measurement_io.layouts.lab_file import form_of
from measurement_io.native import contents as native_contents
from measurement_io.native.scheme import (
    EXPECTED,
    SCHEMES,
    WEIGHTS,
    NativeHeader,
    View,
    plain_text,
    write,
)


def save_capture(path: str | os.PathLike[str], capture: Capture, *, force: bool = False) -> None:
    """Write a capture to a native HDF5 file; reading it gives the same bits.

    The name may have any extension, and its folder has to exist. `force` replaces an existing file.

    Examples
    --------
    >>> measurement_io.save_capture("capture.h5", capture)
    >>> read = measurement_io.open_capture("capture.h5")
    >>> np.array_equal(read.data, capture.data), dict(read.meta)
    (True, {'room': 'B 12'})
    """
    checks.instance("save_capture: capture", capture, Capture)
    texts = {"array_name": plain_text("AntennaArray.name", capture.array.name)}
    values = {"data": capture.data, **instrument_values(capture.array, capture.waveform)}
    text = json_file.to_json("Capture.meta", capture.meta)
    write(Path(path), "capture", text, texts, values, force=force)


def save_volume(path: str | os.PathLike[str], volume: Volume, *, force: bool = False) -> None:
    """Write a volume to a native HDF5 file, as `save_capture`.

    Examples
    --------
    >>> grid = clradar.VoxelGrid([-0.01, -0.01, 0.3], [0.01, 0.01, 0.01], (3, 3, 2))
    >>> measurement_io.save_volume("volume.h5", clradar.Volume(np.full(grid.shape, 2j), grid))
    >>> bool((measurement_io.open_volume("volume.h5").data == 2j).all())
    True
    """
    checks.instance("save_volume: volume", volume, Volume)
    save_planes(path, volume.data, volume.grid, volume.meta, volume.scale, force=force)


def save_planes(
    path: str | os.PathLike[str],
    planes: Planes,
    grid: VoxelGrid,
    meta: Mapping[str, Any],
    scale: ImageScale | None,
    *,
    force: bool = False,
) -> None:
    """Write a volume whose planes are read a few at a time; as `save_volume`."""
    texts = {}
    values = {f"{name}_m": getattr(grid, f"{name}_m") for name in ("x", "y", "z")}
    values |= {"data": planes}
    values |= {"origin_m": grid.origin_m, "spacing_m": grid.spacing_m}
    if scale is not None:
        texts["array_name"] = plain_text("AntennaArray.name", scale.array.name)
        values |= instrument_values(scale.array, scale.waveform)
        values[WEIGHTS] = scale.weights
    text = json_file.to_json("Volume.meta", meta)
    views = _views(planes, grid)
    write(Path(path), "volume", text, texts, values, force=force, views=views)


def instrument_values(array: AntennaArray, waveform: Waveform) -> dict[str, Any]:
    """Return antennas and frequencies by the names of their datasets."""
    values: dict[str, Any] = {
        "tx": np.arange(array.n_tx),
        "rx": np.arange(array.n_rx),
        "frequency_hz": waveform.frequencies_hz,
        "tx_m": array.tx_m,
        "rx_m": array.rx_m,
    }
    for side, own in zip(("tx", "rx"), array.sides, strict=True):
        pattern, gain = own.pattern, own.gain
        values |= {
            f"{side}_antenna_gain": gain if gain is None else gain.view(np.float64).reshape(-1, 2),
            f"{side}_antenna_boresight": own.boresight,
            f"{side}_pattern": pattern and np.array([pattern.gain_dbi, pattern.exponent]),
            f"{side}_pattern_angle_deg": pattern and pattern.angle_deg,
            f"{side}_pattern_field": pattern and pattern.field,
        }
    return {name: value for name, value in values.items() if value is not None}


def _views(planes: Planes, grid: VoxelGrid) -> list[View]:
    """Return what viewers show of a volume, first the one shown at once; nothing beyond float32."""
    try:
        depth = depth_map_of_planes(planes, grid, DYNAMIC_RANGE_DB)
    except ModelError:
        return []
    title = "Maximum amplitude along z; the radar sees x to the left"
    level = View("max_projection", title, depth.amplitude, "amplitude", None)
    title = f"Depth of the maximum along z, within {depth.dynamic_range_db:g} dB of the strongest"
    return [level, View("depth_map", title, depth.depth_m, "depth", "m")]


Record = Capture | Volume | ChannelCalibration


def read_if_native(path: Path, kind: str | None = None) -> tuple[NativeHeader, Any] | None:
    """Return header and record of a native file of a format, or of any; None for another's file."""
    with reading(path, EXPECTED):
        found = confined.run(native_contents.read_if_native, path, kind)
        if found is None:
            return None
        meta = json_file.parse_object(found["provenance"], strict=True)
        names = ("format", "version", "created", "unchecked")
        values = {**found["texts"], **found["arrays"]}
        record = _RECORDS[found["format"]](path, meta, values)
        return NativeHeader(*(found[name] for name in names)), record


def read_native(path: Path, kind: str | None = None) -> tuple[NativeHeader, Any]:
    """As `read_if_native`, of a file that has to be native."""
    noun = "native file" if kind is None else SCHEMES[kind].noun
    if form_of(path, f"a file of {noun}") != "hdf5":
        fail(path, f"a file of {noun} (HDF5)", "no HDF5 file")
    found = read_if_native(path, kind)
    if found is None:
        fail(path, noun, "an HDF5 file of another program, without the attribute clradar_format")
    return found


def format_of(path: Path) -> str | None:
    """Return the format of a native file; None for an HDF5 file of another program."""
    with reading(path, EXPECTED):
        return confined.run(native_contents.format_of, path)


def _capture(path: Path, meta: dict[str, Any], found: native_contents.Contents) -> Capture:
    return Capture(_read_only(found["data"]), *instrument(found), meta)


def _volume(path: Path, meta: dict[str, Any], found: native_contents.Contents) -> Volume:
    axes = [found[name] for name in ("x_m", "y_m", "z_m")]
    counts = (len(axes[0]), len(axes[1]), len(axes[2]))
    grid = VoxelGrid(found["origin_m"], found["spacing_m"], counts)
    for axis, have, want in zip("xyz", axes, (grid.x_m, grid.y_m, grid.z_m), strict=True):
        if np.abs(have - want).max() > 1e-9 * max(1.0, float(np.abs(want).max())):
            fail(path, f"{axis}_m by origin_m and spacing_m", "another axis")
    scale = None
    if WEIGHTS in found:
        scale = ImageScale(*instrument(found), found[WEIGHTS])
    return Volume(_read_only(found["data"]), grid, meta, scale)


def instrument(found: native_contents.Contents) -> tuple[AntennaArray, Waveform]:
    """Return the antennas and the frequencies of a capture or of its channels."""
    sides: dict[str, Any] = {}
    for side in ("tx", "rx"):
        lobe, gain = found.get(f"{side}_pattern"), found.get(f"{side}_antenna_gain")
        table: dict[str, Any] = {
            name: found.get(f"{side}_pattern_{name}") for name in ("angle_deg", "field")
        }
        pattern = None if lobe is None else AntennaPattern(*lobe.tolist(), **table)
        sides[f"{side}_pattern"] = pattern
        sides[f"{side}_gain"] = None if gain is None else gain.view(np.complex128)[:, 0]
        sides[f"{side}_boresight"] = found.get(f"{side}_antenna_boresight")
    array = AntennaArray(found["tx_m"], found["rx_m"], found["array_name"], **sides)
    return array, Waveform(found["frequency_hz"])


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False  # the record keeps a read-only array without another copy
    return array


def open_volume(path: str | os.PathLike[str]) -> Volume:
    """Return the volume of a native HDF5 file.

    Examples
    --------
    >>> grid = clradar.VoxelGrid([-0.01, -0.01, 0.3], [0.01, 0.01, 0.01], (3, 3, 2))
    >>> measurement_io.save_volume("volume.h5", clradar.Volume(np.full(grid.shape, 2j), grid))
    >>> measurement_io.open_volume("volume.h5").grid.z_m.tolist()
    [0.3, 0.31]
    """
    return read_native(Path(path), "volume")[1]


LIVE, DEAD, NOISY = 0, 1, 2  # names of the values of `tx_state` and `rx_state`
_OF_RESPONSE = ("tx_gain", "rx_gain", "tx_delay_s", "rx_delay_s")
_BY_CHANNEL = tuple(
    f"{s}_{n}" for s in ("tx", "rx") for n in ("noise", "phase_std_rad", "delay_std_s")
)
_NUMBERS = ("target_amplitude", "residual_db", "noise_residual_db")


def save_channels(
    path: str | os.PathLike[str], channels: ChannelCalibration, *, force: bool = False
) -> None:
    """Write calibrated channels to a native HDF5 file, as `save_capture`.

    The target needs a parameter at least.

    Examples
    --------
    >>> measurement_io.save_channels("channels.h5", channels)
    >>> read = measurement_io.open_channels("channels.h5")
    >>> read.target, read.target_position["z_m"], read.residual_db
    ('corner', 0.3, -20.0)
    """
    names = list(channels.target_position)
    if not names or any("," in name for name in names):
        raise ModelError(
            "ChannelCalibration.target_position: expected at least one name, and none with a "
            f"comma, got {names!r:.100}"
        )
    texts = {
        "array_name": plain_text("AntennaArray.name", channels.array.name),
        "target": plain_text("ChannelCalibration.target", channels.target),
        "target_parameters": plain_text("ChannelCalibration.target_position", ",".join(names)),
    }

    values = instrument_values(channels.array, channels.waveform)
    values |= {name: getattr(channels.response, name) for name in _OF_RESPONSE}
    values |= {name: getattr(channels, name) for name in _BY_CHANNEL}
    for side in ("tx", "rx"):
        state = np.full(len(getattr(channels.array, f"{side}_m")), LIVE)
        state[getattr(channels, f"dead_{side}")] = DEAD
        state[getattr(channels, f"noisy_{side}")] = NOISY
        values[f"{side}_state"] = state
    values["target_position"] = np.array([float(v) for v in channels.target_position.values()])
    values["target_covariance"] = channels.target_covariance
    values["reference_hz"] = np.array([channels.response.reference_hz])
    values |= {name: np.array([getattr(channels, name)]) for name in _NUMBERS}
    text = json_file.to_json("ChannelCalibration.meta", channels.meta)
    write(Path(path), "channels", text, texts, values, force=force)


def open_channels(path: str | os.PathLike[str]) -> ChannelCalibration:
    """Return the calibrated channels of a native HDF5 file.

    Examples
    --------
    >>> measurement_io.save_channels("channels.h5", channels)
    >>> measurement_io.open_channels("channels.h5").response.tx_gain.tolist()
    [(1+0j), 1j]
    """
    return read_native(Path(path), "channels")[1]


def _channels(
    path: Path, meta: dict[str, Any], found: native_contents.Contents
) -> ChannelCalibration:
    array, waveform = instrument(found)
    fields: dict[str, Any] = {name: found[name] for name in _BY_CHANNEL}
    fields |= {name: float(found[name][0]) for name in _NUMBERS}
    for side in ("tx", "rx"):
        state = found[f"{side}_state"]
        if not np.isin(state, (LIVE, DEAD, NOISY)).all():
            fail(path, f"{side}_state of 0, 1 and 2", f"{state.min()} to {state.max()}")
        fields[f"dead_{side}"] = np.flatnonzero(state == DEAD)
        fields[f"noisy_{side}"] = np.flatnonzero(state == NOISY)
    names = found["target_parameters"].split(",")
    position = found["target_position"]
    if len(set(names)) != len(names) or len(names) != len(position):
        wanted = f"target_parameters of {len(position)} different names"
        fail(path, wanted, clean(", ".join(names)))
    of_response = {name: found[name] for name in _OF_RESPONSE}
    response = ChannelResponse(**of_response, reference_hz=float(found["reference_hz"][0]))
    return ChannelCalibration(
        response=response,
        array=array,
        waveform=waveform,
        target=found["target"],
        target_position=dict(zip(names, position.tolist(), strict=True)),
        target_covariance=found["target_covariance"],
        meta=meta,
        **fields,
    )


_RECORDS = {"capture": _capture, "volume": _volume, "channels": _channels}
"""What makes the record of a format."""

"""The native HDF5 file of calibrated channels, version 1 (docs/files.md)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import ModelError
from clradar.files import json_text
from clradar.files.failures import clean, fail, reading
from clradar.model import ChannelCalibration, ChannelResponse
from measurement_io.native import contents as native_contents
from measurement_io.native.captures_volumes import contents, instrument
from measurement_io.native.scheme import (
    EXPECTED,
    NativeHeader,
    check_hdf5,
    instrument_bytes,
    instrument_version,
    plain_text,
    write,
    write_dataset,
    write_instrument,
)

LIVE, DEAD, NOISY = 0, 1, 2
"""Names of the values of `tx_state` and `rx_state`."""

_BY_CHANNEL = (
    ("gain", "complex gain at reference_hz", None),
    ("delay_s", "delay", "s"),
    ("noise", "noise of one sample relative to the median echo", None),
    ("phase_std_rad", "standard deviation of the phase", "rad"),
    ("delay_std_s", "standard deviation of the delay", "s"),
)
_CHANNEL_BYTES = 52
"""Of the complex gain, four numbers and the state."""

_NUMBERS = (
    ("target_amplitude", "amplitude of the echo relative to the target's model", None),
    ("residual_db", "energy that is left of the echoes", "dB"),
    ("noise_residual_db", "what noise alone would leave", "dB"),
)


def save_channels(
    path: str | os.PathLike[str], channels: ChannelCalibration, *, force: bool = False
) -> None:
    """Write calibrated channels to a native HDF5 file; reading it gives the same bits.

    Parameters
    ----------
    path : path-like
        Target, whatever its extension. Its folder has to exist.
    channels : ChannelCalibration
    force : bool
        Replace an existing file.

    Raises
    ------
    ModelError
        `meta` holds what JSON cannot hold, a name is no plain text, or the target has no parameter.
        Nothing is written.
    OutputError
        The target exists and `force` is not set, its folder does not exist, or the system refuses
        to write. Nothing half-written stays behind.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import open_channels, save_channels
    >>> channels = clradar.ChannelCalibration(
    ...     response=clradar.ChannelResponse([1, 1j], [2], [0, 1e-12], [0], 77e9),
    ...     array=clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]], "lab"),
    ...     waveform=clradar.Waveform([76e9, 77e9, 78e9]),
    ...     target="corner", target_position={"x_m": 0.0, "y_m": 0.1, "z_m": 0.3},
    ...     target_covariance=np.eye(3), target_amplitude=1.0,
    ...     dead_tx=[], dead_rx=[], noisy_tx=[], noisy_rx=[],
    ...     tx_noise=[0, 0], rx_noise=[0], tx_phase_std_rad=[0.01, 0.01], rx_phase_std_rad=[0.01],
    ...     tx_delay_std_s=[0, 0], rx_delay_std_s=[0], residual_db=-20.0, noise_residual_db=-21.0,
    ...     meta={},
    ... )
    >>> save_channels("channels.h5", channels)
    >>> read = open_channels("channels.h5")
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

    def fill(data: Any) -> None:
        write_instrument(data, channels.array, channels.waveform)
        for side in ("tx", "rx"):
            for name, long_name, unit in _BY_CHANNEL:
                owner = channels.response if name in ("gain", "delay_s") else channels
                value = getattr(owner, f"{side}_{name}")
                write_dataset(data, f"{side}_{name}", value, f"{side.title()} {long_name}", unit)
            state = np.full(len(getattr(channels.array, f"{side}_m")), LIVE, dtype=np.int32)
            state[getattr(channels, f"dead_{side}")] = DEAD
            state[getattr(channels, f"noisy_{side}")] = NOISY
            write_dataset(data, f"{side}_state", state, "0 live, 1 dead, 2 noisy", None)
        position = np.array([float(v) for v in channels.target_position.values()])
        write_dataset(data, "target_position", position, ", ".join(names), None)
        covariance = channels.target_covariance
        write_dataset(data, "target_covariance", covariance, "covariance of the position", None)
        reference = np.array([channels.response.reference_hz])
        write_dataset(data, "reference_hz", reference, "where a gain is the whole response", "Hz")
        for name, long_name, unit in _NUMBERS:
            write_dataset(data, name, np.array([getattr(channels, name)]), long_name, unit)

    text = json_text.to_json("ChannelCalibration.meta", channels.meta)
    array = channels.array
    size = instrument_bytes(array, channels.waveform) + (array.n_tx + array.n_rx) * _CHANNEL_BYTES
    version = instrument_version(array)
    write(Path(path), "channels", text, texts, fill, size_bytes=size, force=force, version=version)


def open_channels(path: str | os.PathLike[str]) -> ChannelCalibration:
    """Return the calibrated channels of a native HDF5 file.

    Raises
    ------
    MeasurementError
        Missing, no native file, a capture or a volume, a newer version, damaged, or NaN.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import open_channels, save_channels
    >>> channels = clradar.ChannelCalibration(
    ...     response=clradar.ChannelResponse([1, 1j], [2], [0, 1e-12], [0], 77e9),
    ...     array=clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]], "lab"),
    ...     waveform=clradar.Waveform([76e9, 77e9, 78e9]),
    ...     target="corner", target_position={"x_m": 0.0, "y_m": 0.1, "z_m": 0.3},
    ...     target_covariance=np.eye(3), target_amplitude=1.0,
    ...     dead_tx=[], dead_rx=[], noisy_tx=[], noisy_rx=[],
    ...     tx_noise=[0, 0], rx_noise=[0], tx_phase_std_rad=[0.01, 0.01], rx_phase_std_rad=[0.01],
    ...     tx_delay_std_s=[0, 0], rx_delay_std_s=[0], residual_db=-20.0, noise_residual_db=-21.0,
    ...     meta={},
    ... )
    >>> save_channels("channels.h5", channels)
    >>> read = open_channels("channels.h5")
    >>> read.response.tx_gain.tolist(), read.response.reference_hz / 1e9
    ([(1+0j), 1j], 77.0)
    """
    file = Path(path)
    check_hdf5(file, "a native file of channels")
    return read_channels(file)[1]


def read_channels(path: Path) -> tuple[NativeHeader, ChannelCalibration]:
    """Return header and channels of a native file; every failure is a `MeasurementError`."""
    with reading(path, EXPECTED):
        header, found = contents(native_contents.read_channels, path)
        array, waveform = instrument(found)
        fields: dict[str, Any] = {}
        for side in ("tx", "rx"):
            for name, _, _ in _BY_CHANNEL:
                fields[f"{side}_{name}"] = found[f"{side}_{name}"]
            state = found[f"{side}_state"]
            if not np.isin(state, (LIVE, DEAD, NOISY)).all():
                fail(path, f"{side}_state of 0, 1 and 2", f"{state.min()} to {state.max()}")
            fields[f"dead_{side}"] = np.flatnonzero(state == DEAD)
            fields[f"noisy_{side}"] = np.flatnonzero(state == NOISY)
        for name, _, _ in _NUMBERS:
            fields[name] = float(found[name][0])
        names = found["target_parameters"].split(",")
        position = found["target_position"]
        if len(set(names)) != len(names) or len(names) != len(position):
            fail(
                path,
                f"target_parameters of {len(position)} different names",
                clean(", ".join(names)),
            )
        response = ChannelResponse(
            tx_gain=fields.pop("tx_gain"),
            rx_gain=fields.pop("rx_gain"),
            tx_delay_s=fields.pop("tx_delay_s"),
            rx_delay_s=fields.pop("rx_delay_s"),
            reference_hz=float(found["reference_hz"][0]),
        )
        return header, ChannelCalibration(
            response=response,
            array=array,
            waveform=waveform,
            target=found["target"],
            target_position=dict(zip(names, position.tolist(), strict=True)),
            target_covariance=found["target_covariance"],
            meta=header.meta,
            **fields,
        )

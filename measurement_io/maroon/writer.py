"""Write a capture in the form in which recorded frames of the 94 x 94 imager are exchanged."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clradar import arrays
from clradar.errors import ModelError, OutputError
from clradar.model import Capture, checks
from measurement_io.antenna_file import CHANNELS, IMAGING
from measurement_io.atomic import replacing
from measurement_io.failures import clean, shown
from measurement_io.maroon.folders import FRAMES_FOLDER, VARIANTS


def save_maroon_frame(
    path: str | os.PathLike[str],
    capture: Capture,
    *,
    frame: int = 0,
    variant: str = "raw",
    timestamp_us: int | Sequence[int] = 0,
    number_of_measurements: int | None = None,
    channels: int = CHANNELS,
    force: bool = False,
) -> Path:
    """Write one frame into `path/radar_<low>_<high>_<points>/calibrated_data/`.

    Parameters
    ----------
    path : path-like
        The `<object>/<distance>` folder. It is made if only its last part is missing.
    capture : Capture
        Of `clradar.arrays.qar50()`.
    frame : int
        Number of the frame, 0 to 999999.
    variant : {"raw", "emptyfiltered"}
    timestamp_us : int or sequence of int, microseconds
    number_of_measurements : int, optional
        Frames of the whole recording; `frame + 1` if not given.
    channels : {96, 94}
        96 as the instrument writes (channels 0 and 95 are zero), or the imaging antennas alone.
    force : bool
        Write into a radar folder that exists already, and replace the frame if it is there.

    Returns
    -------
    Path
        The frame's file. Reading it gives the same bits of data and frequencies.

    Raises
    ------
    ModelError
        Another array, or an argument that cannot be meant.
    OutputError
        The radar folder exists and `force` is not set, it belongs to another waveform, or the
        system refuses to write.
    """
    number = checks.whole("save_maroon_frame: frame", frame, 0, 999_999)
    total = number + 1 if number_of_measurements is None else number_of_measurements
    total = checks.whole("save_maroon_frame: number_of_measurements", total, 1)
    variant = checks.one_of("save_maroon_frame: variant", variant, VARIANTS)
    if channels not in (CHANNELS, CHANNELS - 2):
        checks.fail("save_maroon_frame: channels", "96 or 94", repr(channels))
    if not capture.array.same_positions(arrays.qar50()):
        raise ModelError(
            "Capture.array: expected the 94 x 94 antennas of qar50(), which the file form takes "
            f"for granted, got '{capture.array.name}' with {capture.array.n_tx} Tx and "
            f"{capture.array.n_rx} Rx"
        )
    frequencies = capture.waveform.frequencies_hz
    low, high = (float(f) / 1e9 for f in frequencies[[0, -1]])
    radar = Path(path) / f"radar_{low}_{high}_{len(frequencies)}"
    calibration = {
        "frequency_low_ghz": low,
        "frequency_high_ghz": high,
        "frequency_points": len(frequencies),
    }
    _make_folders(radar, force=force)
    _write_calibration(radar / "calibration.json", calibration)

    xr = capture.data.transpose(1, 0, 2)
    if channels == CHANNELS:
        whole = np.zeros((CHANNELS, CHANNELS, len(frequencies)), np.complex64)
        whole[IMAGING, IMAGING, :] = xr
        xr = whole
    holder = np.empty((), dtype=object)
    holder[()] = {
        "xr": np.ascontiguousarray(xr),
        "fvec": np.array(frequencies),
        "number_of_measurements": total,
        "timestamp_us": np.atleast_1d(np.asarray(timestamp_us, dtype=np.int64)),
    }
    suffix = "" if variant == "raw" else f"_{variant}"
    target = radar / FRAMES_FOLDER / f"{number:06d}{suffix}.npy"
    with replacing(target, force=force) as temporary, open(temporary, "xb") as file:
        header = {"descr": "|O", "fortran_order": False, "shape": ()}
        np.lib.format.write_array_header_1_0(file, header)
        pickle.dump(holder, file, protocol=4)
    return target


def _make_folders(radar: Path, *, force: bool) -> None:
    try:
        if radar.exists() and not force:
            raise OutputError(
                f"{shown(radar)}: exists already; a frame is added or replaced only with force"
            )
        radar.parent.mkdir(exist_ok=True)
        (radar / FRAMES_FOLDER).mkdir(parents=True, exist_ok=True)
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{shown(radar)}: cannot be made: {clean(error)}") from error


def _write_calibration(path: Path, calibration: dict[str, float | int]) -> None:
    if not path.exists():
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(calibration, indent=2) + "\n", encoding="utf-8")
        return
    # A recording's own file holds more than these three entries, so it is never rewritten.
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
        agrees = all(there.get(key) == value for key, value in calibration.items())
    except (OSError, ValueError, AttributeError) as error:
        raise OutputError(f"{shown(path)}: cannot be read: {clean(error)}") from error
    if not agrees:
        raise OutputError(f"{shown(path)}: belongs to another waveform than the capture")

"""Describe the content of a file or a recording."""

from __future__ import annotations

import os
from pathlib import Path

from clradar.files.failures import clean, reading, shown
from measurement_io.layouts.containers import open_container
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.inspection import inspect_recording
from measurement_io.native import captures_volumes as native
from measurement_io.native import channels_file
from measurement_io.opening import SUPPORTED, kind_of
from measurement_io.record_facts import (
    Description,
    Fact,
    capture_facts,
    channels_facts,
    volume_facts,
)


def describe(path: str | os.PathLike[str]) -> Description:
    """Describe a native file, a recorded frame or a recording.

    Raises
    ------
    MeasurementError
        The file cannot be opened. Of a folder, what is missing or contradictory is listed in
        `missing` and `problems` instead.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import describe, save_capture
    >>> waveform = clradar.Waveform([76e9, 77e9, 78e9])
    >>> array = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]], "lab")
    >>> cycles = waveform.frequencies_hz * 0.6 / clradar.constants.SPEED_OF_LIGHT_M_PER_S
    >>> data = np.exp(-2j * np.pi * cycles) * np.ones((2, 1, 1))  # a path of 0.6 m
    >>> capture = clradar.Capture(data.astype(np.complex64), array, waveform, {"room": "B 12"})
    >>> save_capture("capture.h5", capture)
    >>> print(describe("capture.h5").words["array"])
    lab: 2 Tx, 1 Rx
    """
    source = Path(path)
    with reading(source, SUPPORTED):
        return _describe(source)


def _describe(source: Path) -> Description:
    kind = kind_of(source)
    if kind == "folder":
        found = inspect_recording(source)
        facts, problems, missing = tuple(found.facts), tuple(found.problems), tuple(found.missing)
        return Description(shown(source), "recording", facts, problems, missing)
    if kind == "container":
        return _describe_container(source)
    if kind == "frame":
        capture = read_frame_file(source)
        return Description(shown(source), "recorded frame", tuple(capture_facts(capture)))
    header = native.read_header(source)
    opening = [
        Fact("created", clean(header.created), clean(header.created)),
        Fact("file version", str(header.version), header.version),
    ]
    if header.format == "capture":
        more = capture_facts(native.read_capture(source)[1])
    elif header.format == "channels":
        more = channels_facts(channels_file.read_channels(source)[1])
    else:
        more = volume_facts(native.read_volume(source)[1])
    return Description(shown(source), f"native {header.format}", (*opening, *more))


def _describe_container(source: Path) -> Description:
    with open_container(source) as container:
        facts = [
            Fact(clean(key.name)[:80], key.description, key.description)
            for key in container.keys.values()
        ]
        problem = "it needs a layout with its keys, axes and units"
        return Description(shown(source), container.kind, tuple(facts), (problem,))

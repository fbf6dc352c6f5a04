"""Describe the content of a file or a recording."""

from __future__ import annotations

import os
from pathlib import Path

from clradar.files.failures import clean, reading, shown
from clradar.model import Capture, Volume
from measurement_io.layouts.lab_file import LabFile
from measurement_io.layouts.template import layout_template
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.inspection import inspect_recording
from measurement_io.native import records as native
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
    >>> from measurement_io import describe, save_capture
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
    opened = native.read_native(source)
    assert opened is not None  # `kind_of` has seen that it is native
    header, record = opened
    opening = [
        Fact("created", clean(header.created), clean(header.created)),
        Fact("file version", str(header.version), header.version),
    ]
    if isinstance(record, Capture):
        more = capture_facts(record)
    elif isinstance(record, Volume):
        more = volume_facts(record)
    else:
        more = channels_facts(record)
    return Description(shown(source), f"native {header.format}", (*opening, *more))


def _describe_container(source: Path) -> Description:
    found = LabFile.opened(source)
    facts = [
        Fact(clean(key.name)[:80], key.description, key.description) for key in found.keys.values()
    ]
    problem = "it needs a layout with its keys, axes and units: fill in the template"
    template = layout_template(found.kind, found.keys.values())
    return Description(shown(source), found.kind, tuple(facts), (problem,), template=template)

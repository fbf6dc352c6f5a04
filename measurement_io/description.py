"""Describe the content of a file or a recording."""

from __future__ import annotations

import os
from pathlib import Path

from clradar.files.failures import clean, reading, shown
from measurement_io.layouts.lab_file import LabFile
from measurement_io.layouts.template import layout_template
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.inspection import inspect_recording
from measurement_io.native import records as native
from measurement_io.opening import SUPPORTED, kind_of
from measurement_io.record_facts import Description, Fact, facts_of


def describe(path: str | os.PathLike[str]) -> Description:
    """Describe a native file, a recorded frame or a recording.

    Examples
    --------
    >>> from measurement_io import describe, save_capture
    >>> save_capture("capture.h5", capture)
    >>> print(describe("capture.h5").words["array"])
    lab: 2 Tx, 1 Rx
    """
    source = Path(path)
    name = shown(source)
    with reading(source, SUPPORTED):
        kind = kind_of(source)
        if kind == "folder":
            found = inspect_recording(source)
            facts, problems = tuple(found.facts), tuple(found.problems)
            return Description(name, "recording", facts, problems, tuple(found.missing))
        if kind == "container":
            file = LabFile.opened(source)
            keys = [(clean(k.name)[:80], k.description) for k in file.keys.values()]
            problem = "it needs a layout with its keys, axes and units: fill in the template"
            template = layout_template(file.kind, file.keys.values())
            facts = tuple(Fact(key, text, text) for key, text in keys)
            return Description(name, file.kind, facts, (problem,), template=template)
        if kind == "frame":
            return Description(name, "recorded frame", tuple(facts_of(read_frame_file(source))))
        header, record = native.read_native(source)
        created = clean(header.created)
        opening = [Fact("created", created, created)]
        opening.append(Fact("file version", str(header.version), header.version))
        return Description(name, f"native {header.format}", (*opening, *facts_of(record)))

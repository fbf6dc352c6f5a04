"""Describe the content of a file or a recording."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from clradar.files.failures import clean, reading, shown
from measurement_io.layouts.contents import Key
from measurement_io.layouts.lab_file import LabFile
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.inspection import inspect_recording
from measurement_io.native import records as native
from measurement_io.opening import SUPPORTED, kind_of
from measurement_io.record_facts import Description, Fact, facts_of

_LISTED = 200

_SETTINGS = """\
[data]
key = "?"  # of the complex numbers; of two keys: real = "..." and imag = "..."
axes = ["tx", "rx", "freq"]  # of this file, in its order; also "pair", "frame", "part", "one"
# pair_order = "tx_major"  # of an axis "pair": all Rx of the first Tx come first; or "rx_major"
# pick = {chirp = 0}  # of any other axis: the index that is used
phase_sign = -1  # exp(-j 2 pi f d / c); +1 for its conjugate: `clradar diagnose` finds out

[tx]  # and the same under [rx]
key = "?"  # of the positions; or x, y and z: keys or numbers; or values, file, array = "qar50"
# orientation = "columns"  # of key, where every antenna is a column
# channels = 96  # on the data's axis, where the positions do not say it
# select = "1:95"  # of these channels: a slice, as in Python, or a list

[rx]
key = "?"

[antennas]  # x to the right of a person who faces the radar, y up, z away from it
unit = "?"  # m, cm, mm, um
# columns = ["x", "y"]  # of key, values or file; others are numbers under [tx] and [rx]
# origin = [0.0, 0.0, 0.0]  # centre of the aperture in the file's frame and unit
# mirror = ["x"]  # coordinates whose sign is turned

[frequency]
key = "?"  # or values; or start, points and either stop or step: numbers, or keys of them
unit = "?"  # Hz, kHz, MHz, GHz

# [meta]
# keys = []  # whose numbers and text are kept with the capture
"""


def describe(path: str | os.PathLike[str]) -> Description:
    """Describe a native file, a recorded frame or a recording.

    Examples
    --------
    >>> measurement_io.save_capture("capture.h5", capture)
    >>> print(measurement_io.describe("capture.h5").words["array"])
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
            template = _layout_template(file.kind, file.keys.values())
            facts = tuple(Fact(key, text, text) for key, text in keys)
            return Description(name, file.kind, facts, (problem,), template=template)
        if kind == "frame":
            return Description(name, "recorded frame", tuple(facts_of(read_frame_file(source))))
        header, record = native.read_native(source)
        created = clean(header.created)
        opening = [Fact("created", created, created)]
        opening.append(Fact("file version", str(header.version), header.version))
        return Description(name, f"native {header.format}", (*opening, *facts_of(record)))


def _layout_template(kind: str, keys: Iterable[Key]) -> str:
    """Return a layout for a file of this kind, with its keys as comments and "?" to fill in."""
    listed = list(keys)
    lines = [f"# Layout of {kind} with these keys:"]
    lines += [f"#   {key}" for key in listed[:_LISTED]]
    if len(listed) > _LISTED:
        lines.append(f"#   and {len(listed) - _LISTED} more")
    lines.append('# Fill in every "?"; docs/layouts.md explains all settings.')
    return "\n".join(lines) + "\n\n" + _SETTINGS

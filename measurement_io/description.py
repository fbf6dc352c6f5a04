"""Describe what a file or a recording holds, or verify it by reading all of it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from clradar.errors import MeasurementError
from clradar.files.failures import clean, reading, shown
from clradar.model.progress import Progress
from measurement_io.layouts.contents import Key
from measurement_io.layouts.lab_file import LabFile, layout_needed
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.inspection import Findings, inspect_recording
from measurement_io.native import records as native
from measurement_io.native.scheme import SCHEMES
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
key = "?"  # of the positions; or x, y and z: keys or numbers; or file, or array = "qar50"
# orientation = "columns"  # of key, where every antenna is a column
# channels = 96  # on the data's axis, where the positions do not say it
# select = "1:95"  # of these channels: a slice, as in Python, or a list

[rx]
key = "?"

[antennas]  # x to the right of a person who faces the radar, y up, z away from it
unit = "?"  # m, cm, mm, um
# columns = ["x", "y"]  # of key; others are numbers under [tx] and [rx]
# origin = [0.0, 0.0, 0.0]  # centre of the aperture in the file's frame and unit
# mirror = ["x"]  # coordinates whose sign is turned

[frequency]
key = "?"  # or values; or start, points and either stop or step: numbers, or keys of them
unit = "?"  # Hz, kHz, MHz, GHz
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
            found = Findings()
            inspect_recording(source, found)
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


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Outcome of a verification; `ok` without problems.

    Attributes
    ----------
    path : str
    checked : tuple of str
        What was found right.
    problems : tuple of str
        What is wrong.
    """

    path: str
    checked: tuple[str, ...]
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return not self.problems

    def __str__(self) -> str:
        lines = [f"{self.path}: {'all right' if self.ok else 'not all right'}"]
        lines += [f"  ok: {line}" for line in self.checked]
        lines += [f"  problem: {line}" for line in self.problems]
        return "\n".join(lines)


def check_file(path: str | os.PathLike[str], *, progress: Progress | None = None) -> CheckReport:
    """Verify a native file, a recorded frame or a recording; all of its data is read.

    Of a native file: format, types, shapes, checksums, finite values, axes against the grid. Of a
    recording: frames of both variants, frequencies, numbering, time stamps, images and JSON files.
    What cannot be opened is a problem in the report and raises nothing.

    Examples
    --------
    >>> measurement_io.save_capture("capture.h5", capture)
    >>> measurement_io.check_file("capture.h5").ok
    True
    >>> with open("capture.h5", "r+b") as file:
    ...     _ = file.truncate(5000)
    >>> report = measurement_io.check_file("capture.h5")
    >>> report.ok, len(report.problems)
    (False, 1)
    """
    source = Path(path)
    found = Findings()
    try:
        with reading(source, SUPPORTED):
            kind = kind_of(source)
            if kind == "container":
                raise layout_needed(source)
            if kind == "folder":
                inspect_recording(source, found, whole=True, progress=progress)
            elif kind == "frame":
                read_frame_file(source)
                found.checked.append("the pickle holds nothing but numbers and text")
                found.checked.append("keys, shapes, frequencies, the folder's name agree; finite")
            else:
                _check_native(source, found)
    except MeasurementError as error:
        found.problems.append(str(error))
    return CheckReport(shown(source), tuple(found.checked), tuple(found.problems))


def _check_native(path: Path, found: Findings) -> None:
    header, _ = native.read_native(path)
    noun = SCHEMES[header.format].noun
    found.checked.append(f"native: {noun}, version {header.version}, text attributes intact")
    found.checked.append("all data read: types, shapes, stored in full, values finite")
    found.problems += [
        f"/entry/data/{name}: carries no Fletcher-32 checksum" for name in header.unchecked
    ]
    if not header.unchecked:
        found.checked.append("every dataset has its Fletcher-32 checksums and they are right")


def _layout_template(kind: str, keys: Iterable[Key]) -> str:
    """Return a layout for a file of this kind, with its keys as comments and "?" to fill in."""
    lines = [f"#   {key}" for key in keys]
    if len(lines) > _LISTED:
        lines[_LISTED:] = [f"#   and {len(lines) - _LISTED} more"]
    end = '# Fill in every "?"; docs/layouts.md explains all settings.'
    return "\n".join([f"# Layout of {kind} with these keys:", *lines, end, "", _SETTINGS])

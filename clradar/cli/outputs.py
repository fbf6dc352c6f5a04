"""Checks of the names of outputs, before the long work starts, and the files that are written.

The folder that an output goes into exists; one that is the output is made. Nothing is written over
an input, nor into a data set or a recording.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

import clradar as cl
import measurement_io as io
from clradar import __version__
from clradar.cli import console
from clradar.cli.groups import call, plain
from clradar.errors import OutputError
from clradar.files import atomic
from clradar.files.hashing import holds_still
from clradar.files.json_file import write_json
from clradar.jobs import Job
from clradar.versions import package_versions
from measurement_io.maroon.folders import is_own_name

Result = TypeVar("Result", cl.Capture, cl.Volume, cl.ChannelCalibration)

OWNED_DEPTH = 3  # folders above a file that may own it: a recording is three above its frames


def check_outputs(outputs: Iterable[Path | None]) -> None:
    """Raise unless every output of the command that runs may be written."""
    written = set()
    wanted = [output for output in outputs if output is not None]
    atomic.remove_left(wanted)
    for output in wanted:
        with atomic.writing(output):
            place = os.path.realpath(output).casefold()  # case may not count on this disk
            if place in written:
                raise OutputError(f"{output}: is named twice as an output; choose another name")
            written.add(place)
            _check_place(output)
            atomic.refuse_existing(output, force=call.force)


def check_folder(
    folder: Path, replaced: Collection[str] | None = None, *, resumed: bool = False
) -> None:
    """Raise unless a folder is missing or empty, or may be written into with --force, or `resumed`.

    `replaced` names the only files that it may replace, none of which is an input; None: any.
    """
    with atomic.writing(folder):
        if os.path.lexists(folder) and not folder.is_dir():
            raise OutputError(f"{folder}: expected a folder's name, got a file")
        atomic.remove_left([folder])
        _check_place(folder)
        for path in call.paths:
            place = Path(os.path.realpath(path))
            kept = (os.path.realpath(folder / name) for name in replaced or ())
            if any(map(place.is_relative_to, kept)):
                raise OutputError(
                    f"{folder}: holds the input '{path}', which would be replaced; choose another "
                    "folder"
                )
        there = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    if there and not (call.force or resumed):
        raise OutputError(
            f"{folder}: holds files already; choose another folder, or replace an earlier result "
            "with --force"
        )
    for name in there:
        if replaced is not None and name not in replaced and not resumed:
            raise OutputError(
                f"{folder}: holds '{name}', which --force would delete; choose another folder"
            )


def _check_place(output: Path) -> None:
    """Raise unless an output may be where it is."""
    there = [path for path in call.paths if path.exists() and output.exists()]
    if any(output.samefile(path) for path in there):  # by links, too
        raise OutputError(f"{output}: is also an input; choose another name")
    if not output.parent.is_dir():
        raise OutputError(f"{output}: expected an existing folder, got '{output.parent}'")
    if not output.is_dir() and not os.access(output.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{output}: the folder '{output.parent}' cannot be written to")
    # A link is followed, and is a file where it lies.
    for place in (os.path.realpath(output), os.path.realpath(output.parent) + f"/{output.name}"):
        for folder in tuple(Path(place).parents)[:OWNED_DEPTH]:
            owner = _owner_of(folder, Path(place).relative_to(folder).parts[0])
            if owner is not None:
                raise OutputError(
                    f"{output}: belongs to the {owner} '{folder}'; choose another name"
                )


def _owner_of(folder: Path, name: str) -> str | None:
    """What a folder is, if what has this name in it is its own; None if anybody may write it."""
    if (folder / "manifest.json").is_file():  # first: the import takes half a second
        from clradar.dataset.folder import OWN_NAMES, is_dataset

        if name in OWN_NAMES and is_dataset(folder):
            return "data set"
    return "recording" if is_own_name(folder, name) else None


@contextmanager
def whole_folder(folder: Path, replaced: Collection[str]) -> Iterator[Path]:
    """Yield a folder to fill, which becomes `folder` at the end, in place of an earlier result.

    A failure leaves everything as it was. `replaced` as in `check_folder`.
    """
    with atomic.new_folder(folder) as temporary:
        made = temporary / "made"
        made.mkdir()
        yield made
        # Another process may have made it meanwhile.
        check_folder(folder, replaced)
        if call.force:
            atomic.swap_folder(made, folder, temporary / "replaced")
        else:
            atomic.move_folder(made, folder)


def begun(
    folder: Path,
    work: str,
    own: Sequence[str],
    found: str,
    *,
    read: Mapping[str, Sequence[Path]] = MappingProxyType({}),
    **more: Any,
) -> Job:
    """Work in a folder, which goes on with the same options and `more`, and files that hold still.

    Files that fit the pattern `found` are what it can go on with; `own` names what --force removes.
    `read` has the files of options whose inputs are not in the provenance.
    """
    inputs = {name: call.files_of(read.get(name) or paths) for name, paths in call.inputs.items()}
    for path, record in call.records.items():
        if not holds_still(path, record):
            raise OutputError(f"{path}: changed while it was read; repeat the command")
    key = {**plain({**call.options, **more}, paths=False), "clradar": __version__}
    return Job(
        folder=folder, work=work, own=own, inputs=inputs, key=key, force=call.force,
        resumable=lambda at: any(at.glob(found)),
    )  # fmt: skip


def write(
    path: Path | None, content: Any, text: str = "", *, force: bool = False, **more: Any
) -> Any:
    """Write what an option asks for, whole or not at all, and say what it is.

    Without a path it asks for nothing. `content` is, or a function that makes: a capture, a volume,
    channels or a record, which get the provenance with `more`; a mesh; a figure; or a page. With
    `force`, or --force, it may replace a file.
    """
    if path is None:
        return None
    force = force or call.force
    if callable(content):
        with console.bar("writing the page" if path.suffix.startswith(".htm") else "drawing"):
            content = content()
    if isinstance(content, Mapping):
        write_json(path, {**content, **provenance(**more)}, force=force)
    elif isinstance(content, str):
        atomic.write_file(path, content.encode(), force=force)
    elif hasattr(content, "savefig"):
        cl.plot.save_figure(content, path, force=force)
    elif hasattr(content, "faces"):  # in metres; the name says the format
        import trimesh

        from clradar.files.meshes.parts import ply_of_parts

        kind, surface = path.suffix.lower()[1:], (content.vertices_m, content.faces)
        if kind == "ply":
            part, names = np.asarray(content.part), content.part_names
            made = ply_of_parts(*surface, part, names, content.texture_m)
        else:
            made = trimesh.Trimesh(*surface, process=False).export(file_type=kind)
        atomic.write_file(path, made.encode() if isinstance(made, str) else made, force=force)
    else:
        content = save(path, content, provenance(**more), force=force)
    if text:
        console.line(f"{path}: {text}")
    return content


def save(path: Path, result: Result, origin: Mapping[str, Any], *, force: bool = True) -> Result:
    """Write a capture, a volume or channels with their provenance; return it as written."""
    result = replace(result, meta={**result.meta, **origin})
    writers: Any = {cl.Capture: io.save_capture, cl.Volume: io.save_volume}
    writers.get(type(result), io.save_channels)(path, result, force=force)
    return result


def provenance(inputs: Iterable[Path] | None = None, **more: Any) -> dict[str, Any]:
    """What goes into `meta` of files: versions, options and `more`, digests of (these) inputs."""
    files = call.files_of(call.paths if inputs is None else inputs)
    records = call.records_of(files)
    return {
        "clradar": __version__,
        "packages": package_versions(),
        "python": platform.python_version(),
        "machine": platform.platform(),
        "command": call.command,
        "options": plain({**call.options, **more}),
        "inputs": [{"file": path.name, "sha256": records[path]["sha256"]} for path in files],
    }


MESHES = (".ply", ".stl", ".obj", ".off")  # formats of mesh files; .ply has parts and texture, too


def turned(mesh: cl.hand.HandMesh, angle_deg: float, center_m: Sequence[float]) -> cl.hand.HandMesh:
    """A hand turned about the vertical through `center_m`."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    centre_m = np.asarray(center_m, dtype=np.float64)
    return mesh.moved(np.eye(3), -centre_m).moved(matrix, centre_m)


def described(capture: cl.Capture, origin: Mapping[str, Any]) -> cl.Capture:
    """A capture with all of `meta` and `origin` as a JSON text: frames hold numbers and strings."""
    record = {**capture.meta, **origin}
    with suppress(KeyError, TypeError, ValueError):
        # An earlier conversion's is text; as text in text its escapes would double every time.
        record["provenance"] = json.loads(record["provenance"])
    return replace(capture, meta={**capture.meta, "provenance": json.dumps(record)})

"""Files of others: ``convert`` and ``export``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import clradar as cl
import measurement_io
from clradar.cli import console, images as img, options as opt, outputs as out, parse
from clradar.errors import MeasurementError, ModelError
from clradar.files.failures import fail
from clradar.jobs.lock import made_folder


def write_captures(
    source: Path, output: Path, variant: str | None, antennas: opt.AntennaOptions
) -> None:
    """Write `output/000000.h5`, `000000_emptyfiltered.h5` ..., one frame in memory at a time."""
    from measurement_io.maroon.folders import find_radar_folder, frames

    out.check_folder(output, resumed=True)
    there = frames(find_radar_folder(source)) if source.is_dir() else {}
    first = variant or next((name for name, found in there.items() if found), "raw")
    recording = measurement_io.open_recording(source, variant=first, **opt.arguments_of(antennas))
    variants = recording.variants if variant is None else (variant,)
    views = {name: recording.with_variant(name) for name in variants}
    files = {
        output / f"{n:06d}{'' if name == 'raw' else f'_{name}'}.h5": partial(view.__getitem__, i)
        for name, view in views.items()
        for i, n in enumerate(view.frame_numbers)
    }
    beside, written = opt.paths_in(opt.arguments_of(antennas)), list[str]()
    if output.is_dir():
        out.check_outputs(files)
    with made_folder(output):
        for path, opened in console.track(files.items(), "converting"):
            try:
                capture = opened()
            except MeasurementError as error:
                console.warning(error)
                continue
            own = {key: capture.meta[key] for key in ("frame", "variant")}
            inputs = [*(opt.frame_files(capture) if source.is_dir() else [source]), *beside]
            out.save(path, capture, out.provenance(inputs, **own), force=opt.call.force)
            written.append(path.name)
            del capture  # before the next one is read
        if len(written) < len(files):
            raise MeasurementError(f"{source}: {len(written)} of {len(files)} frames converted")
    counts = ", ".join(console.counted(len(view), f"{name} frame") for name, view in views.items())
    console.line(f"{output}: {counts}, {written[0]} to {written[-1]}")


def write_recording(sources: Sequence[Path], output: Path, antennas: opt.AntennaOptions) -> None:
    """Write `output/radar_<low>_<high>_<points>` with a frame for each capture."""
    from measurement_io.maroon.folders import BESIDE
    from measurement_io.opening import kind_of

    for path in sources:
        if path.is_dir():
            fail(path, "a capture, with --to maroon", "a folder")
    out.check_folder(output)
    out.check_folder(
        output, [*BESIDE, *(path.name for path in output.glob("radar_*"))], resumed=True
    )
    beside, opened = opt.paths_in(opt.arguments_of(antennas)), list[Path]()

    def read(path: Path) -> cl.Capture:
        opened.append(path)
        own = antennas if kind_of(path) == "frame" else opt.AntennaOptions()
        found = measurement_io.open_capture(path, **opt.arguments_of(own))
        return out.described(found, out.provenance([path, *beside]))

    captures = img.ReadOnAccess(sources, read)
    with console.bar("converting") as progress:
        try:
            radar = measurement_io.save_recording(
                output, captures, force=opt.call.force, progress=progress
            )
        except ModelError as error:
            raise ModelError(f"{opened[-1]}: {error}") from error
    console.line(f"{radar}: {console.counted(len(sources), 'frame')}")


def convert_command(
    *,
    sources: list[Path] = opt.argument(
        "Recorded .npy frame, radar folder, or the folder that holds one; with --layout another "
        "program's .h5, .mat, .npz or .npy; with --to maroon one or several captures.",
    ),
    output: Path = opt.output_option(
        "Capture to write (HDF5); else the folder to make.", folder=True
    ),
    to: Literal["native", "maroon"] = opt.option(
        "One capture file, or a recording as a MAROON folder.", "native"
    ),
    all_frames: bool = opt.option(
        "Every frame of a recording to a capture of its own.", False, without="--to --frame"
    ),
    layout: Path | None = opt.option(
        "Which key and axis of another program's file is what (docs/layouts.md); `clradar inspect` "
        "prints a template.",
        metavar="LAB.toml",
        without="--to --all-frames",
    ),
    frames: opt.FrameOptions,
    antennas: opt.AntennaOptions,
) -> None:
    """The content of a SOURCE decides its kind, not its name. The data stays as recorded, bit by
    bit.
    """
    if to == "maroon":
        if frames != opt.FrameOptions():
            raise opt.wrong_usage("--frame, --variant", "expected without --to maroon")
        write_recording(sources, output, antennas)
        return
    source, *others = sources
    if others:
        raise opt.wrong_usage("SOURCE", f"expected one, got {len(sources)}")
    if all_frames:
        write_captures(source, output, frames.variant, antennas)
        return
    out.check_outputs([output])
    how = {**opt.arguments_of(frames), **opt.arguments_of(antennas)}
    capture = opt.noted(source, measurement_io.open_capture(source, layout=layout, **how))
    if layout is not None:
        sides = (capture.meta["layout"][name] for name in ("tx", "rx"))
        opt.call.inputs["--layout"] += [Path(side["file"]) for side in sides if "file" in side]
        out.check_outputs([output])  # they are known only now
    low, high = capture.waveform.frequencies_hz[[0, -1]] / 1e9
    shape = " x ".join(str(n) for n in capture.data.shape)
    out.write(output, capture, f"{shape} (tx, rx, frequency), {low:g} to {high:g} GHz")


def export_command(
    source: Path = opt.argument("Volume or capture, recorded .npy frame, or radar folder."),
    *,
    output: Path = opt.output_option(
        "File to write; its ending decides: .vti, .ply, .mat or .npz."
    ),
    depth_map: bool = opt.option("Of a volume its depth map; to .ply it is that anyway.", False),
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
) -> None:
    """A volume goes to .vti (ParaView), its depth map to .ply (MeshLab, Blender: the amplitude as
    grey), and either of them or a capture to .mat (MATLAB) or .npz (numpy), in metres and hertz.
    """
    from measurement_io.export import FORMATS

    parse.ends_in(*FORMATS)("-o", output)
    content: Any = img.open_image(source, frames)
    if depth_map and isinstance(content, cl.Capture):
        raise opt.wrong_usage("--depth-map", f"expected a volume, got a capture: {source}")
    if depth_map or (output.suffix.lower() == ".ply" and not isinstance(content, cl.Capture)):
        content = content.depth_map(depth.dynamic_range_db)
    else:
        content = replace(content, meta={**content.meta, **out.provenance()})
    measurement_io.export_file(output, content, force=opt.call.force)
    kind = {cl.Capture: "capture", cl.Volume: "volume"}.get(type(content), "depth map")
    shape = content.__array__().shape[:: 1 if kind == "capture" else -1]  # x first, as everywhere
    console.line(f"{output}: {kind}, {' x '.join(map(str, shape))}")

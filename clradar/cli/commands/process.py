"""``clradar process``: all frames of a recording, cleaned, imaged, compared, aligned, and drawn."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

from clradar.cli.comparison import figure_labels
from clradar.cli.frames import FrameFitOptions, Frames, FramesOptions, FrameSteps
from clradar.cli.options.common import DEVICE, FORCE, WorkerOptions
from clradar.cli.options.groups import REQUIRED, argument, output_option, recorded, wrong_usage
from clradar.cli.options.hand import RigFileOptions, ShapeOptions, StartNames
from clradar.cli.options.measured import (
    CleaningOptions,
    DepthMapOptions,
    GridOptions,
    ImagingOptions,
)
from clradar.cli.outputs import check_place_of_folder, provenance
from clradar.cli.parse import chosen_frames
from clradar.cli.recordings import OWN_NAMES, RecordingWork
from clradar.jobs import open_devices


def command(
    *,
    recording: Path = argument(
        "Radar folder, or folder of captures (.h5).", REQUIRED, metavar="RECORDING"
    ),
    simulated: list[Path] | None = argument(
        "Compare with these: each a recording with the same frames, or one volume or capture.",
        metavar="SIMULATED",
    ),
    output: Path = output_option(
        "Folder to write; a begun one is resumed.", REQUIRED, metavar="DIR"
    ),
    chosen: FramesOptions,
    cleaning: CleaningOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    depth: DepthMapOptions,
    fits: FrameFitOptions,
    shape: ShapeOptions,
    rigged: RigFileOptions,
    processes: WorkerOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Each frame is freed of the empty room (the mean of its frames), gated, corrected, imaged,
    compared and aligned, and a hand is fitted to it, as far as the options ask for it; all images
    are on one grid: that of the options, or the one that shows the object of the first frame. DIR
    gets a table over time, curves, a picture of every frame and an animation. One frame is in
    memory at a time.
    """
    others, grid = tuple(simulated or ()), voxels.grid()
    _ = cleaning.gate  # wrong usage is reported before a file is read
    starts = None if fits.fit_hand is None else StartNames(fits.fit_hand)
    # Files count by their content, wherever they lie.
    inputs: dict[str, list[Path]] = {
        "--empty": [] if cleaning.empty is None else [cleaning.empty],
        "--channels": [] if cleaning.channels is None else [cleaning.channels],
        "--mesh": [] if fits.mesh is None else [fits.mesh],
        "--fit-hand": [] if starts is None else starts.files,
        "--rig": rigged.files,
    }
    read = [recording, *others, *(path for files in inputs.values() for path in files)]
    check_place_of_folder(output, OWN_NAMES, inputs=read)
    source = Frames(recording, chosen.variant)
    if source.numbers is None:
        raise wrong_usage("RECORDING", "expected a radar folder, or a folder of captures (.h5)")
    numbers, beside = chosen_frames(chosen.frames, source.numbers), list(map(Frames, others))
    for frames in beside:
        frames.check_frames(numbers, recording)
    options = recorded(
        chosen, cleaning, voxels, imaging, depth, fits, shape, rigged,
        recording=recording, simulated=others,
    )  # fmt: skip
    hand = None if starts is None else fits.settings(starts, shape, rigged, fits.search_deg)
    where = processes.where(device, read)
    steps = FrameSteps(
        source=recording, run_name=token_hex(), folder=output, chosen=chosen, cleaning=cleaning,
        imaging=imaging, depth=depth, simulated=others, fits=fits, grid=grid,
        origin=provenance("process", [p for p in read[1:] if p.is_file()], **options),
        device=open_devices(device).first if where.here else None,
    )  # fmt: skip
    inputs["RECORDING"] = source.files_of(numbers)
    inputs["SIMULATED"] = [file for frames in beside for file in frames.files_of(numbers)]
    inputs["--empty"] = [file for path in inputs["--empty"] for file in Frames(path).files_of()]
    places = ("recording", "empty", "channels", "mesh", "fit_hand", "rig", "mapping")
    RecordingWork(
        source=source, steps=steps, voxels=voxels, numbers=numbers, inputs=inputs, where=where,
        hand=hand, force=force,
        settings={
            **options, **dict.fromkeys(places), "simulated": [path.is_dir() for path in others],
            "poses": None if starts is None else starts.names, "numbers": numbers,
        },
        labels=[recording.name or str(recording), *figure_labels(others, [{} for _ in others])],
    ).run()  # fmt: skip

"""``clradar process``: all frames of a recording, cleaned, imaged, compared, aligned, and drawn."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

from clradar.cli import options as opt
from clradar.cli.comparison import figure_labels
from clradar.cli.frames import RECORDS, Frames, FrameSteps, ProcessOptions
from clradar.cli.outputs import check_place_of_folder, provenance, settings_of
from clradar.cli.parse import chosen_frames
from clradar.cli.recordings import OWN_NAMES, RecordingWork
from clradar.jobs import Job


def command(
    *,
    recording: Path = opt.argument(
        "Radar folder, or folder of captures (.h5).", opt.REQUIRED, metavar="RECORDING"
    ),
    simulated: list[Path] | None = opt.argument(
        "Compare with these: each a recording with the same frames, or one volume or capture.",
        metavar="SIMULATED",
    ),
    output: Path = opt.output_option(
        "Folder to write; a begun one is resumed.", opt.REQUIRED, metavar="DIR", folder=True
    ),
    how: ProcessOptions,
    voxels: opt.GridOptions,
    processes: opt.WorkerOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
) -> None:
    """Each frame is freed of the empty room (the mean of its frames), gated, corrected, imaged,
    compared and aligned, and a hand is fitted to it, as far as the options ask for it; all images
    are on one grid: that of the options, or the one that shows the object of the first frame. DIR
    gets a table over time, curves, a picture of every frame and an animation. One frame is in
    memory at a time.
    """
    others = tuple(simulated or ())
    starts = None if how.fit_hand is None else opt.StartNames(how.fit_hand)
    single = {
        "--channels": how.channels,
        "--mesh": how.mesh,
        "--rig": how.rig,
        "--mapping": how.mapping,
    }
    # Files count by their content, wherever they lie.
    inputs = {name: [path] for name, path in single.items() if path is not None}
    inputs["--fit-hand"] = [] if starts is None else starts.files
    beside = [path for files in inputs.values() for path in files]
    read = [recording, *others, *beside, *([] if how.empty is None else [how.empty])]
    check_place_of_folder(output, OWN_NAMES, inputs=read)
    source = Frames(recording, how.variant)
    if source.numbers is None:
        raise opt.wrong_usage("RECORDING", "expected a radar folder, or a folder of captures (.h5)")
    numbers, compared = chosen_frames(how.frames, source.numbers), list(map(Frames, others))
    for frames in compared:
        frames.check_frames(numbers, recording)
    hand = None if starts is None else how.settings(starts)
    where = processes.where(device, read)
    origin = provenance(path for path in read[1:] if path.is_file())
    inputs["RECORDING"] = source.files_of(numbers)
    inputs["SIMULATED"] = [file for frames in compared for file in frames.files_of(numbers)]
    inputs["--empty"] = [] if how.empty is None else Frames(how.empty).files_of()
    key = settings_of(
        origin, simulated=[path.is_dir() for path in others], numbers=numbers,
        fit_hand=None if starts is None else starts.names,
    )  # fmt: skip
    steps = FrameSteps(
        source=recording, run_name=token_hex(), folder=output, how=how, simulated=others,
        grid=voxels.grid(), origin=origin, device=where.first if where.here else None,
    )  # fmt: skip
    labels = [recording.name or str(recording), *figure_labels(others, [{} for _ in others])]
    job = Job(
        folder=output, work="processed recording", own=OWN_NAMES, inputs=inputs, key=key,
        force=force, resumable=lambda folder: any(folder.glob(f"{RECORDS}/*.json")),
    )  # fmt: skip
    RecordingWork(
        source=source, steps=steps, voxels=voxels, numbers=numbers, labels=labels, where=where,
        hand=hand,
    ).run(job)  # fmt: skip

"""``clradar process``: all frames of a recording, cleaned, imaged, compared, aligned, and drawn."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

from clradar.cli import options as opt
from clradar.cli.comparison import figure_labels
from clradar.cli.frames import RECORDS, Frames, FrameSteps, ProcessOptions
from clradar.cli.outputs import begun, check_folder, provenance
from clradar.cli.parse import chosen_frames
from clradar.cli.recordings import OWN_NAMES, RecordingWork


def process_command(
    *,
    recording: Path = opt.argument("Radar folder, or folder of captures (.h5)."),
    simulated: list[Path] | None = opt.argument(
        "Compare with these: each a recording with the same frames, or one volume or capture.",
    ),
    output: Path = opt.output_option(
        "Folder to write; a begun one is resumed.", metavar="DIR", folder=True
    ),
    how: ProcessOptions,
    voxels: opt.GridOptions,
    processes: opt.WorkerOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """As far as the options ask for it, each frame is freed of the empty room (the mean of its
    frames), gated, corrected, imaged, compared and aligned, and a hand is fitted to it. Without
    ranges the first frame places the grid of all. DIR gets a table over time, curves, a picture of
    every frame and an animation.
    """
    others = tuple(simulated or ())
    starts = None if how.fit_hand is None else opt.StartNames(how.fit_hand)
    check_folder(output, OWN_NAMES, resumed=True)
    source = Frames(recording, how.variant)
    if not source.files:
        raise opt.wrong_usage("RECORDING", "expected a radar folder, or a folder of captures (.h5)")
    numbers, compared = chosen_frames(how.frames, [*source.files]), list(map(Frames, others))
    for frames in compared:
        frames.check_frames(numbers, recording)
    hand = None if starts is None else how.settings(starts)
    where = processes.where(device)
    read = {"RECORDING": source.files_of(numbers)}
    read["SIMULATED"] = [file for frames in compared for file in frames.files_of(numbers)]
    if how.empty is not None:
        read["--empty"] = Frames(how.empty).files_of()
    steps = FrameSteps(
        source=recording, run_name=token_hex(), folder=output, how=how, simulated=others,
        grid=voxels.grid(), origin=provenance(), device=where.first if where.here else None,
    )  # fmt: skip
    labels = [recording.name or str(recording), *figure_labels(others, [{} for _ in others])]
    job = begun(
        output, "processed recording", OWN_NAMES, f"{RECORDS}/*.json", read=read, numbers=numbers,
        simulated=[path.is_dir() for path in others],
        fit_hand=None if starts is None else starts.names,
    )  # fmt: skip
    RecordingWork(
        source=source, steps=steps, voxels=voxels, numbers=numbers, labels=labels, where=where,
        hand=hand,
    ).run(job)  # fmt: skip

"""``clradar process``: all frames of a recording, cleaned, imaged, compared, aligned, and drawn."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

from clradar.cli.comparison import figure_labels
from clradar.cli.frames import (
    CleaningOptions,
    FrameAlignOptions,
    FrameHandOptions,
    Frames,
    FramesOptions,
    FrameSteps,
    KeepOptions,
)
from clradar.cli.options.common import DEVICES, FORCE, WorkerOptions
from clradar.cli.options.groups import REQUIRED, argument, output_option, recorded, wrong_usage
from clradar.cli.options.hand import RigFileOptions, ShapeOptions, StartNames
from clradar.cli.options.measured import DepthMapOptions, GateOptions, GridOptions, ImagingOptions
from clradar.cli.outputs import check_place_of_folder, provenance
from clradar.cli.recordings import OWN_NAMES, RecordingWork
from clradar.jobs import open_devices


def command(
    *,
    recording: Path = argument(
        REQUIRED, "Radar folder, or folder of captures (.h5).", metavar="RECORDING"
    ),
    simulated: list[Path] | None = argument(
        None,
        "Compare with these: each a recording with the same frames, or one volume or capture.",
        metavar="SIMULATED",
    ),
    output: Path = output_option(
        REQUIRED, "Folder to write; a begun one is resumed.", metavar="DIR"
    ),
    chosen: FramesOptions,
    cleaning: CleaningOptions,
    gate: GateOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    depth: DepthMapOptions,
    aligned: FrameAlignOptions,
    hand: FrameHandOptions,
    shape: ShapeOptions,
    rigged: RigFileOptions,
    kept: KeepOptions,
    processes: WorkerOptions,
    device: str | None = DEVICES,
    force: bool = FORCE,
) -> None:
    """Each frame is averaged, freed of the empty room, gated, corrected, imaged, compared and
    aligned, and a hand is fitted to it, as far as the options ask for it; all images are on one
    grid: that of the options, or the one that shows the object of the first frame. DIR gets a table
    over time, curves, a picture of every frame and an animation. One frame is in memory at a time.
    """
    others, grid = tuple(simulated or ()), voxels.grid()
    gate.settings()  # wrong usage is reported before a file is read
    starts = None if hand.fit_hand is None else StartNames(hand.fit_hand)
    # Files count by their content, wherever they lie.
    inputs: dict[str, list[Path]] = {
        "--empty": [] if cleaning.empty is None or cleaning.by_frame else [cleaning.empty],
        "--channels": cleaning.files,
        "--mesh": [] if aligned.mesh is None else [aligned.mesh],
        "--fit-hand": [] if starts is None else starts.files,
        "--rig": rigged.files,
    }
    extra = [path for files in inputs.values() for path in files]
    by_frame = [cleaning.empty] if cleaning.empty and cleaning.by_frame else []
    check_place_of_folder(output, OWN_NAMES, inputs=[recording, *others, *by_frame, *extra])
    source = Frames(recording, chosen.variant)
    if source.numbers is None:
        raise wrong_usage("RECORDING", "expected a radar folder, or a folder of captures (.h5)")
    groups = chosen.groups(source.numbers)
    beside = [Frames(path) for path in (*others, *by_frame)]
    for frames in beside:
        frames.check_frames([group[0] for group in groups], recording)
    options = recorded(
        chosen, cleaning, gate, voxels, imaging, depth, aligned, hand, shape, rigged, kept,
        recording=recording, simulated=others,
    )  # fmt: skip
    fits = None if starts is None else hand.settings(starts, shape, rigged, aligned.search_deg)
    where = processes.where(device, [recording, *others, *by_frame, *extra])
    steps = FrameSteps(
        source=recording, run_name=token_hex(), folder=output, chosen=chosen, cleaning=cleaning,
        gate=gate, imaging=imaging, depth=depth, simulated=others, aligned=aligned, grid=grid,
        hand=starts is not None, kept=kept,
        origin=provenance("process", [p for p in (*others, *extra) if p.is_file()], **options),
        device=open_devices(device).first if where.here else None,
    )  # fmt: skip
    inputs["SIMULATED"] = [path for path in others if path.is_file()]
    inputs["--empty"] = [file for path in inputs["--empty"] for file in Frames(path).all_files()]
    places = ("recording", "empty", "channels", "mesh", "fit_hand", "rig", "mapping")
    RecordingWork(
        source=source, others=[one for one in beside if one.numbers is not None], steps=steps,
        voxels=voxels, groups=groups, inputs=inputs, where=where, hand=fits, force=force,
        settings={
            **options, **dict.fromkeys(places), "simulated": [path.is_dir() for path in others],
            "poses": None if starts is None else starts.names,
        },
        labels=[recording.name or str(recording), *figure_labels(others, [{} for _ in others])],
    ).run()  # fmt: skip

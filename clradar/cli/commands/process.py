"""``clradar process``: all frames of a recording, cleaned, imaged, compared, aligned, and drawn."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from secrets import token_hex

from clradar.cli.comparison import figure_labels
from clradar.cli.frames import (
    CleaningOptions,
    FrameAlignOptions,
    FrameHandOptions,
    FramesOptions,
    FrameSteps,
    KeepOptions,
)
from clradar.cli.options.common import DevicesOption, ForceOption, WorkerOptions
from clradar.cli.options.groups import REQUIRED, argument, output_option, recorded
from clradar.cli.options.hand import (
    RigFileOptions,
    ShapeOptions,
    sequence_settings,
)
from clradar.cli.options.measured import (
    DepthMapOptions,
    GateOptions,
    GridOptions,
    ImagingOptions,
)
from clradar.cli.outputs import check_place_of_folder, provenance
from clradar.cli.parse import wrong_usage
from clradar.cli.recordings import prepared, print_summary


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
    device: DevicesOption = None,
    force: ForceOption = False,
) -> None:
    """Each frame is averaged, freed of the empty room, gated, corrected, imaged, compared and
    aligned, and a hand is fitted to it, as far as the options ask for it; all images are on one
    grid: that of the options, or the one that shows the object of the first frame. DIR gets a table
    over time, curves, a picture of every frame and an animation. One frame is in memory at a time.
    """
    from clradar.cli.frames import Frames, all_files, files_of
    from clradar.cli.recordings import OWN_NAMES, RecordingWork
    from clradar.jobs import open_devices

    others = list(simulated or [])
    window = gate.settings()
    voxels.grid()  # wrong usage is reported before a file is read
    aligned.check(hand)
    fitting = hand.fitting(shape, rigged, aligned.search_deg)
    extra = [path for path in (cleaning.empty, cleaning.channels, aligned.mesh) if path is not None]
    if fitting is not None:
        extra += [*fitting.files, *rigged.files]
    check_place_of_folder(output, OWN_NAMES, inputs=[recording, *others, *extra])
    source = Frames.open(recording, chosen.variant)
    if source.numbers is None:
        raise wrong_usage("RECORDING", "expected a radar folder, or a folder of captures (.h5)")
    groups = chosen.groups(source.numbers)
    by_frame = [cleaning.empty] if cleaning.empty and cleaning.empty_by == "frame" else []
    beside = [Frames.open(path) for path in (*others, *by_frame)]
    for frames in beside:
        frames.check_frames([group[0] for group in groups], recording)
    # What is the same at every frame need not stay in memory here.
    beside = [frames for frames in beside if frames.numbers is not None]
    options = recorded(
        chosen, cleaning, gate, voxels, imaging, depth, aligned, hand, shape, rigged, kept,
        recording=recording, simulated=others,
    )  # fmt: skip
    files = [path for path in (*others, *extra) if path.is_file()]
    origin = provenance("process", options, files)
    # Files count by their content, wherever they lie.
    inputs = {
        "SIMULATED": [path for path in others if path.is_file()],
        "--empty": [] if cleaning.empty is None or by_frame else all_files(cleaning.empty),
        "--channels": [] if cleaning.channels is None else [cleaning.channels],
        "--mesh": [] if aligned.mesh is None else [aligned.mesh],
        "--fit-hand": [] if fitting is None else fitting.files,
        "--rig": rigged.files,
    }
    settings = {
        **options, "simulated": [path.is_dir() for path in others],
        "poses": None if fitting is None else fitting.named,
        **dict.fromkeys(("recording", "empty", "channels", "mesh", "fit_hand", "rig", "mapping")),
    }  # fmt: skip
    where = processes.where(device, [recording, *others, *extra])
    steps = partial(
        FrameSteps,
        source=recording.absolute(), run_name=token_hex(), folder=output.absolute(),
        chosen=chosen, cleaning=cleaning.absolute(), gate=window, imaging=imaging, depth=depth,
        simulated=tuple(path.absolute() for path in others), aligned=aligned.absolute(),
        hand=fitting is not None, keep=kept.names(), origin=origin,
        device=open_devices(device).first if where.here else None,
    )  # fmt: skip
    work = RecordingWork(
        source=recording, folder=output, groups=groups, origin=origin, where=where,
        files=partial(files_of, source=source, others=beside), settings=settings,
        inputs=inputs, force=force,
        hand=None if fitting is None else sequence_settings(fitting, shape, rigged),
        prepare=lambda: prepared(steps, groups, voxels),
        labels=[recording.name or str(recording), *figure_labels(others, [{} for _ in others])],
    )  # fmt: skip
    records = work.run()
    print_summary(work, records)

"""``clradar process``: all frames of a recording, cleaned, imaged, compared, aligned, and drawn."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from secrets import token_hex
from typing import Any, Literal

from clradar.cli.comparison import figure_labels
from clradar.cli.frame_steps import CAPTURES, VOLUMES, FrameSteps
from clradar.cli.opening import open_written
from clradar.cli.options.clutter import EmptyOptions, GateOptions
from clradar.cli.options.common import DevicesOption, ForceOption, OpenOption, Unit
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option, recorded
from clradar.cli.options.hand import ShapeOptions
from clradar.cli.options.hand_fit import AnyHandOptions, HandFitOptions, sequence_settings
from clradar.cli.options.imaging import DepthMapOptions, GridOptions, ImagingOptions
from clradar.cli.options.recording import Variant
from clradar.cli.options.rig import RigFileOptions
from clradar.cli.options.sequence import ALL, FRAMES_METAVAR, chosen_frames
from clradar.cli.options.values import wrong_usage
from clradar.cli.options.workers import WorkerOptions
from clradar.cli.outputs import check_place_of_folder
from clradar.cli.provenance import provenance
from clradar.cli.recording_preparation import prepared, print_summary
from clradar.model import checks


@dataclass(frozen=True, kw_only=True)
class FramesOptions:
    """Which frames, and how many become one."""

    frames: str = option(ALL, "The frames to process.", metavar=FRAMES_METAVAR)
    variant: Variant | None = option(None, "Variant of the frames. [default: raw]")
    average: int | None = option(
        None, "Take the coherent mean of every N frames, of those that agree.", metavar="N", min=2
    )
    align_phase: bool = option(False, "First rotate the frames of a mean to a common phase.")

    def __post_init__(self) -> None:
        if self.align_phase and self.average is None:
            raise wrong_usage("--align-phase", "expected --average with it")

    def groups(self, there: tuple[int, ...]) -> list[tuple[int, ...]]:
        """The frames that are chosen, in groups of which the mean is taken."""
        chosen = chosen_frames(self.frames, there)
        size = self.average or 1
        return [tuple(chosen[i : i + size]) for i in range(0, len(chosen), size)]


@dataclass(frozen=True, kw_only=True)
class CleaningOptions(EmptyOptions):
    """What is done with a frame before it is imaged."""

    empty_by: Literal["mean", "frame"] = option(
        "mean",
        "Subtract the mean of EMPTY's frames, of those that agree, or that of the same number.",
    )
    channels: Path | None = option(None, "Correct by this file of `clradar channels`.")
    keep_noisy: bool = option(False, "With --channels: do not set noisy channels to zero.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.empty_by == "frame" and (self.empty is None or not self.empty.is_dir()):
            raise wrong_usage("--empty-by", "frame: expected a recording as --empty")
        if self.keep_noisy and self.channels is None:
            raise wrong_usage("--keep-noisy", "expected --channels with it")


@dataclass(frozen=True, kw_only=True)
class FrameAlignOptions:
    """A mesh that is aligned with every frame."""

    mesh: Path | None = option(
        None, "Align this mesh with every frame: its motion goes into the table.", metavar="MESH"
    )
    unit: Unit = option("m", "Unit of length of the mesh file.")
    bias: bool = option(
        False, "Correct the bias of each pose by simulations: about a minute a frame."
    )
    search_deg: float = option(45.0, "Rotations about boresight that are tried.", metavar="DEG")

    def check(self, hand: FrameHandOptions) -> None:
        """Raise unless the options go with a mesh, or with a hand that is searched for."""
        names = [name for name in given(self) if hand.fit_hand is None or name != "--search-deg"]
        if self.mesh is None and names:
            raise wrong_usage(names[0], "expected --mesh with it")

    def settings(self) -> dict[str, Any]:
        """Settings of `calibration.align_mesh`."""
        search_deg = checks.positive("--search-deg", self.search_deg)
        return {"correct_bias": self.bias, "search_deg": search_deg}


@dataclass(frozen=True, kw_only=True)
class FrameHandOptions(AnyHandOptions):
    """A hand that is fitted to every frame, each from the one before."""

    fit_hand: str | None = option(
        None,
        "Fit a hand to every frame, each from the one before; the first from here: as --pose of "
        "`clradar fit-hand`.",
        metavar="POSE,...",
    )

    def fitting(
        self, shape: ShapeOptions, rigged: RigFileOptions, search_deg: float
    ) -> HandFitOptions | None:
        """The options of the fit, if there is one."""
        if self.fit_hand is None:
            for name in (*given(self), *given(shape), *given(rigged)):
                raise wrong_usage(name, "expected --fit-hand with it")
            return None
        known = {one.name: getattr(self, one.name) for one in fields(AnyHandOptions)}
        return HandFitOptions(pose=self.fit_hand, search_deg=search_deg, **known)


@dataclass(frozen=True, kw_only=True)
class KeepOptions:
    """What is written of every frame beside its depth map."""

    keep_captures: bool = option(False, "Write the cleaned capture of every frame (HDF5).")
    keep_volumes: bool = option(False, "Write the image of every frame (HDF5).")

    def names(self) -> tuple[str, ...]:
        """The folders of what is kept."""
        wanted = {CAPTURES: self.keep_captures, VOLUMES: self.keep_volumes}
        return tuple(name for name, kept in wanted.items() if kept)


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
    show: OpenOption = False,
) -> None:
    """Each frame is averaged, freed of the empty room, gated, corrected, imaged, compared and
    aligned, and a hand is fitted to it, as far as the options ask for it; all images are on one
    grid: that of the options, or the one that shows the object of the first frame. DIR gets a table
    over time, curves, a picture of every frame, an animation and, with SIMULATED, a page with a
    time line. One frame is in memory at a time.
    """
    from clradar.cli.frame_sources import Frames, all_files, files_of
    from clradar.cli.recording_work import FIGURE, MOVIE, OWN_NAMES, RecordingWork
    from clradar.opencl import open_devices

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
    workers = processes.chosen(output, [recording, *others, *extra])
    empty = cleaning.empty and cleaning.empty.absolute()
    steps = partial(
        FrameSteps,
        source=recording.absolute(), variant=chosen.variant, run_name=token_hex(),
        folder=output.absolute(),
        align_phase=chosen.align_phase,
        empty_by_frame=cleaning.empty_by == "frame", scaling=cleaning.scaling, gate=window,
        channels=cleaning.channels and cleaning.channels.absolute(),
        keep_noisy=cleaning.keep_noisy, imaging=imaging.arguments,
        dynamic_range_db=depth.dynamic_range_db,
        simulated=tuple(path.absolute() for path in others),
        mesh=aligned.mesh and aligned.mesh.absolute(), mesh_unit=aligned.unit,
        align=aligned.settings(), hand=fitting is not None, keep=kept.names(), origin=origin,
        device=None if workers is not None else open_devices(device).first,
    )  # fmt: skip
    work = RecordingWork(
        source=recording, folder=output, groups=groups, origin=origin, workers=workers,
        files=partial(files_of, source=source, others=beside), settings=settings,
        inputs=inputs, device=device, force=force,
        hand=None if fitting is None else sequence_settings(fitting, shape, rigged),
        prepare=lambda: prepared(steps, empty, groups, voxels),
        labels=[recording.name or str(recording), *figure_labels(others, [{} for _ in others])],
    )  # fmt: skip
    records = work.run()
    print_summary(work, records)
    open_written(show, output / FIGURE, output / MOVIE)

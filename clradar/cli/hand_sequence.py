"""``clradar fit-hand --frames``: a moving hand, frame by frame into a folder that resumes."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.console import print_line, print_table, print_warning, progress_bar
from clradar.cli.inputs import form_image
from clradar.cli.options.groups import given, option
from clradar.cli.options.imaging import GridOptions, ImagingOptions
from clradar.cli.options.recording import AntennaOptions, FrameOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_place_of_folder
from clradar.cli.recording_conversion import check_apart, open_source
from clradar.cli.resumable import SETTINGS, FolderStore, begin_work
from clradar.cli.sweep_folder import write_csv
from clradar.errors import ClradarError, ClradarWarning, CompareError, ModelError
from clradar.files import work_folder
from clradar.files.json_file import read_json_object, write_json

if TYPE_CHECKING:
    from calibration.hand_fit.frame_fit import FrameFit
    from calibration.hand_fit.movement_figure import Picture
    from clradar import Capture, Volume
    from clradar.model.progress import Progress
    from measurement_io import Recording

FRAMES, WORK = "frames", "work"
RESULT, TABLE, FIGURE, SHEET = "movement.json", "movement.csv", "movement.png", "contact-sheet.png"

OWN_NAMES = (SETTINGS, RESULT, TABLE, FIGURE, SHEET, FRAMES, WORK)
"""Names in the folder that are its own; --force replaces no others."""

TRACK = "track"
"""In the work folder, with the image of every frame: what is remembered after the last one."""

SHEET_PIXEL_M = 2e-3

ALL = "all"


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """Which frames of recordings of a moving hand, and on how many workers."""

    frames: str | None = option(
        None,
        "Fit a moving hand to these frames of a recording, each from the one before: all, "
        "FIRST:LAST, or numbers with commas. The folder resumes.",
        metavar="all|FIRST:LAST|N,...",
    )
    workers: int | None = option(
        None,
        "With --frames: worker processes for several recordings "
        '(pip install "clradar[dataset]"). [default: one after the other, here]',
        metavar="N",
        min=1,
    )

    def __post_init__(self) -> None:
        if self.frames is None and self.workers is not None:
            raise wrong_usage("--workers", "expected together with --frames")

    def of_frames(self, sources: Sequence[Path]) -> bool:
        """Whether frames of recordings are fitted, and not a single image."""
        if self.frames is None and len(sources) > 1:
            raise wrong_usage("MEASURED", "expected one, or --frames with several recordings")
        return self.frames is not None

    def numbers(self, there: Sequence[int]) -> list[int]:
        """The chosen ones of the frames that are there."""
        text = str(self.frames).strip()
        if text == ALL:
            return list(there)
        try:
            if ":" in text:
                first, last = map(int, text.split(":"))
                chosen = [number for number in there if first <= number <= last]
            else:
                chosen = sorted({int(part) for part in text.split(",")})
        except ValueError:
            raise wrong_usage(
                "--frames", f"expected all, FIRST:LAST or numbers with commas, got '{text}'"
            ) from None
        missing = sorted(set(chosen) - set(there))
        if missing or not chosen:
            raise ModelError(
                f"--frames: expected some of the frames {there[0]} to {there[-1]}, got '{text}'"
            )
        return chosen


@dataclass(frozen=True, slots=True)
class HandSequence:
    """The fit of one recording: its settings, and how its frames are imaged.

    Attributes
    ----------
    source : Path
    folder : Path
        Made where missing; other processes are kept out of it meanwhile.
    chosen : SequenceOptions
    variant : str or None
    voxels : GridOptions
        Of all images; without ranges each is placed about the hand of its frame.
    imaging : ImagingOptions
    settings : mapping
        Of `calibration.fit_hands`.
    origin : mapping
        From `clradar.cli.provenance.provenance`; a folder has to have been begun with its options.
    device : str or None
    force : bool
        Begin anew in a folder that was begun with other settings.
    """

    source: Path
    folder: Path
    chosen: SequenceOptions
    variant: str | None
    voxels: GridOptions
    imaging: ImagingOptions
    settings: Mapping[str, Any]
    origin: Mapping[str, Any]
    device: str | None
    force: bool

    def run(self, progress: Progress | None = None) -> list[FrameFit]:
        """Fit all frames that are not done yet, then write table and figures."""
        recording = open_source(self.source, self.variant, AntennaOptions())
        check_apart(self.folder, recording.path)
        numbers = self.chosen.numbers(recording.frame_numbers)
        with work_folder.held(self.folder, "fit"):
            begin_work(
                self.folder,
                {**self.origin["options"], "clradar": self.origin["clradar"]},
                own=OWN_NAMES,
                work="fit of a moving hand",
                force=self.force,
            )
            if not (self.folder / RESULT).is_file():
                with _removed_if_nothing_is_done(self.folder):
                    self._fit(recording, numbers, progress)
                self._write(numbers)
            shutil.rmtree(self.folder / WORK, ignore_errors=True)
            return [_read(self.folder, number) for number in numbers]

    def _fit(self, recording: Recording, numbers: list[int], progress: Progress | None) -> None:
        from calibration import fit_hands
        from calibration.hand_fit.track import Track
        from clradar.hand import write_pose

        (self.folder / FRAMES).mkdir(exist_ok=True)
        work_folder.remove_temporaries(self.folder / FRAMES)
        store = FolderStore(self.folder / WORK)
        track = Track.from_arrays(store[TRACK]) if TRACK in store else None
        if track is not None and track.frame == numbers[-1]:
            return
        images = _Images(recording, self.voxels, self.imaging, self.device, store)
        for fit, reached in fit_hands(
            images, frames=numbers, array=recording.array, waveform=recording.waveform,
            after=track, device=self.device, progress=progress, **self.settings,
        ):  # fmt: skip
            if fit.state is not None:
                pose = self.folder / FRAMES / f"{fit.frame:06d}.toml"
                write_pose(pose, fit.state.pose, force=True)
            write_json(_frame_file(self.folder, fit.frame), fit.to_dict(), force=True)
            if reached is not None:
                store[TRACK] = reached.to_arrays()

    def _write(self, numbers: list[int]) -> None:
        """Write figures and table, and last the JSON file, which marks the folder as finished."""
        from calibration.hand_fit.movement_figure import (
            movement_figure,
            movement_sheet,
            shown_frames,
        )
        from clradar.plot import save_figure

        fits = [_read(self.folder, number) for number in numbers]
        shown = [fits[i] for i in shown_frames(len(fits))]
        store = FolderStore(self.folder / WORK)
        pictures = [_picture(store, fit.frame) for fit in shown]
        save_figure(movement_sheet(shown, pictures), self.folder / SHEET, force=True)
        title = f"{self.source.name}: angles and tips, with one standard deviation"
        save_figure(movement_figure(fits, title), self.folder / FIGURE, force=True)
        write_csv(self.folder / TABLE, _columns(), map(_row, fits))
        record = {
            "recording": str(self.source),
            "frames": [read_json_object(_frame_file(self.folder, number)) for number in numbers],
            **self.origin,
        }
        write_json(self.folder / RESULT, record, force=True)


@contextmanager
def _removed_if_nothing_is_done(folder: Path) -> Iterator[None]:
    """Leave no settings of a fit that fails before there is anything to resume with."""
    from clradar.cli.resumable import clear

    try:
        yield
    except Exception:  # an interruption is to be resumed
        if not (folder / WORK / f"{TRACK}.npz").is_file():
            clear(folder, OWN_NAMES)
        raise


@dataclass(frozen=True, slots=True)
class _Images(Sequence["Volume"]):
    """Images of the frames of a recording, formed on access; their maxima are kept in a store."""

    recording: Recording
    voxels: GridOptions
    imaging: ImagingOptions
    device: str | None
    store: FolderStore

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return self.recording.frame_numbers

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, index: Any) -> Any:
        from clradar import place_grid
        from clradar.compare import depth_map_of
        from clradar.constants import DYNAMIC_RANGE_DB

        capture: Capture = self.recording[index]
        grid = self.voxels.grid() if given(self.voxels) else place_grid(capture, device=self.device)
        volume = form_image(capture, grid, self.imaging, self.device, "imaging")
        number = self.frame_numbers[index]
        try:
            seen = depth_map_of(volume, DYNAMIC_RANGE_DB, "image")
        except CompareError:
            return volume
        thin = slice(None, None, max(1, round(SHEET_PIXEL_M / float(grid.spacing_m[0]))))
        amplitude = seen.amplitude[thin, thin] / seen.amplitude.max()
        self.store[f"{number:06d}"] = {
            "amplitude": amplitude.astype(np.float32), "x_m": seen.x_m[thin], "y_m": seen.y_m[thin],
        }  # fmt: skip
        return volume


def _picture(store: FolderStore, number: int) -> Picture | None:
    name = f"{number:06d}"
    if name not in store:
        return None
    arrays = store[name]
    return arrays["amplitude"], arrays["x_m"], arrays["y_m"]


def _read(folder: Path, number: int) -> FrameFit:
    from calibration.hand_fit.frame_fit import FrameFit

    path = _frame_file(folder, number)
    return FrameFit.from_dict(read_json_object(path), path)


def _frame_file(folder: Path, number: int) -> Path:
    return folder / FRAMES / f"{number:06d}.json"


def _columns() -> list[str]:
    """Names of the columns of the table."""
    from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES
    from calibration.hand_fit.result import ANGLE_NAMES, DIGITS

    tips = [f"{digit} tip {axis} mm" for digit in DIGITS for axis in (*"xyz", "sd")]
    angles = [f"{name} {what}" for name in ANGLE_NAMES for what in ("deg", "sd deg")]
    shape = ["length mm", "breadth mm", *SHAPE_NAMES[2:]]
    return ["frame", "time s", "how", "misfit per cell", "notes", *tips, *angles, *shape]


def _row(fit: FrameFit) -> list[Any]:
    """One row per frame; cells of frames without a hand are empty."""
    from calibration.hand_fit.hand_state import angles_of

    about = [fit.frame, fit.time_s, fit.how]
    if fit.state is None:
        return [*about, "", "; ".join(fit.notes)]
    columns = np.column_stack([fit.tips_m, fit.tip_std_m])
    angles = np.degrees(np.column_stack([angles_of(fit.state.pose), fit.angle_std_rad]))
    shape = fit.state.shape
    return [
        *about,
        round(fit.misfit_per_cell, 4),
        "; ".join(fit.notes),
        *("" if np.isnan(value) else round(value, 3) for value in (1e3 * columns).ravel().tolist()),
        *(round(value, 3) for value in angles.ravel().tolist()),
        *(round(1e3 * value, 2) for value in (shape.length_m, shape.breadth_m)),
        *(round(value, 4) for value in (*shape.finger_lengths, shape.girth)),
    ]


def fit_sequences(
    chosen: SequenceOptions,
    sources: Sequence[Path],
    output: Path,
    frame: FrameOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    *,
    settings: Mapping[str, Any],
    origin: Mapping[str, Any],
    device: str | None,
    force: bool,
) -> None:
    """Fit recordings into `output`, of several each into a folder of its own there.

    Raises
    ------
    CompareError
        Some of several failed; a warning says why of each.
    """
    if frame.frame is not None:
        raise wrong_usage("--frame", "expected without --frames")
    voxels.grid()  # wrong usage is reported before a file is read
    check_place_of_folder(output, inputs=sources)
    folders = [output]
    if len(sources) > 1:
        folders = [output / f"{i:03d}-{path.resolve().name}" for i, path in enumerate(sources)]
    sequences = [
        HandSequence(source, folder, chosen, frame.variant, voxels, imaging, settings,
                     _with_frames(origin, source, chosen.frames), device, force)
        for source, folder in zip(sources, folders, strict=True)
    ]  # fmt: skip
    failed: list[Path] = []

    def done(sequence: HandSequence, outcome: list[FrameFit] | ClradarError) -> None:
        if not isinstance(outcome, ClradarError):
            print_sequence(sequence.folder, outcome)
            return
        if len(sequences) == 1:
            raise outcome
        print_warning(f"{sequence.source}: {outcome}")
        failed.append(sequence.source)

    fit = _one_by_one if chosen.workers is None else partial(_on_workers, chosen.workers)
    fit(sequences, done)
    if failed:
        raise CompareError(f"{len(failed)} of {len(sequences)} recordings could not be fitted")


def _with_frames(origin: Mapping[str, Any], source: Path, frames: str | None) -> dict[str, Any]:
    options = {**origin["options"], "recording": str(source), "frames": frames}
    return {**origin, "options": options}


Done = Callable[[HandSequence, "list[FrameFit] | ClradarError"], None]


def _one_by_one(sequences: Sequence[HandSequence], done: Done) -> None:
    for sequence in sequences:
        with progress_bar(f"fitting {sequence.source.name}") as progress:
            outcome = _outcome(sequence, progress)
        done(sequence, outcome)


def _on_workers(workers: int, sequences: Sequence[HandSequence], done: Done) -> None:
    """The same on worker processes of this machine."""
    from distributed import as_completed

    from clradar.dataset.engine.cluster import DEVICE, local_cluster
    from clradar.dataset.engine.worker_resources import worker_resources

    resources = worker_resources(min(workers, len(sequences)), sequences[0].device)
    with (
        local_cluster(resources) as (client, end),
        client.as_current(),
        progress_bar("fitting") as progress,
    ):
        futures = {
            client.submit(_with_warnings, sequence, resources={DEVICE: 1}, pure=False): sequence
            for sequence in sequences
        }
        for number, future in enumerate(as_completed(futures), start=1):
            outcome, said = future.result()
            for text in said:
                print_warning(f"{futures[future].source}: {text}")
            done(futures[future], outcome)
            if progress is not None:
                progress(number, len(futures))
        end()


def _outcome(
    sequence: HandSequence, progress: Progress | None = None
) -> list[FrameFit] | ClradarError:
    """The fits of a recording, or why there are none: an error keeps its type on its way back."""
    try:
        return sequence.run(progress)
    except ClradarError as error:
        return error


def _with_warnings(sequence: HandSequence) -> tuple[list[FrameFit] | ClradarError, list[str]]:
    """The outcome on a worker, and what it warned of, each once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ClradarWarning)
        outcome = _outcome(sequence)
    ours = (str(one.message) for one in caught if issubclass(one.category, ClradarWarning))
    return outcome, list(dict.fromkeys(ours))


def print_sequence(folder: Path, fits: Sequence[FrameFit]) -> None:
    """Print a line for each frame that was searched for or has no hand, and a summary."""
    from calibration.hand_fit.frame_fit import FOLLOWED

    rows = [
        [str(fit.frame), f"{fit.time_s:.3f}", fit.how, "; ".join(fit.notes)]
        for fit in fits
        if fit.how != FOLLOWED or fit.notes
    ]
    print_table(("frame", "time (s)", "how", "why"), rows, right=("frame", "time (s)"))
    followed = sum(fit.how == FOLLOWED for fit in fits)
    lost = sum(fit.state is None for fit in fits)
    words = f"{len(fits)} frames, {followed} followed, {len(fits) - followed - lost} searched"
    print_line(f"{folder}: {words}" + (f", {lost} without a hand" if lost else ""))

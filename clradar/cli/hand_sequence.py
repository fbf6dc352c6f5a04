"""The fit of a hand to one recording, frame by frame into a folder that resumes."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.frame_images import FrameImages, picture_of
from clradar.cli.movement_table import write_movement_table
from clradar.cli.options.imaging import GridOptions, ImagingOptions
from clradar.cli.options.recording import AntennaOptions
from clradar.cli.options.sequence import SequenceOptions
from clradar.cli.recording_conversion import check_apart, open_source
from clradar.cli.resumable import SETTINGS, FolderStore, begin_work
from clradar.files import work_folder
from clradar.files.json_file import read_json_object, write_json

if TYPE_CHECKING:
    from calibration.hand_fit.frame_fit import FrameFit
    from clradar.model.progress import Progress

FRAMES, WORK = "frames", "work"
RESULT, TABLE, FIGURE, SHEET = "movement.json", "movement.csv", "movement.png", "contact-sheet.png"

OWN_NAMES = (SETTINGS, RESULT, TABLE, FIGURE, SHEET, FRAMES, WORK)
"""Names in the folder that are its own; --force replaces no others."""

TRACK = "track"
"""In the work folder, with the image of every frame: what is remembered after the last one."""


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

        def images_of(store: FolderStore) -> FrameImages:
            return FrameImages(recording, self.voxels, self.imaging, self.device, store)

        settings = {
            **self.settings, "array": recording.array, "waveform": recording.waveform,
            "device": self.device,
        }  # fmt: skip
        with work_folder.held(self.folder, "fit"):
            return fitted(
                self.folder, self.source, images_of, numbers, settings, self.origin, progress,
                begun=self.origin["options"], force=self.force,
            )  # fmt: skip


def fitted(
    folder: Path,
    source: Path,
    images_of: Callable[[FolderStore], Sequence[Any]],
    numbers: list[int],
    settings: Mapping[str, Any],
    origin: Mapping[str, Any],
    progress: Progress | None,
    *,
    begun: Mapping[str, Any],
    force: bool,
) -> list[FrameFit]:
    """Fit frames into a folder that is there, those that are not done yet; then table and figures.

    Parameters
    ----------
    folder, source : Path
    images_of : callable
        The images of all frames, which keep their pictures (`keep_picture`) in a store.
    numbers : list of int
        The frames that are fitted.
    settings : mapping
        Of `calibration.fit_hands`.
    begun : mapping
        Settings that the folder has to have been begun with.
    origin, force
        As of `HandSequence`.
    """
    begin_work(
        folder, {**begun, "clradar": origin["clradar"]}, own=OWN_NAMES,
        work="fit of a moving hand", force=force,
    )  # fmt: skip
    if not (folder / RESULT).is_file():
        with _removed_if_nothing_is_done(folder):
            _fit(folder, images_of, numbers, settings, progress)
        _write(folder, source, numbers, origin)
    shutil.rmtree(folder / WORK, ignore_errors=True)
    return [_read(folder, number) for number in numbers]


def _fit(
    folder: Path,
    images_of: Callable[[FolderStore], Sequence[Any]],
    numbers: list[int],
    settings: Mapping[str, Any],
    progress: Progress | None,
) -> None:
    from calibration import fit_hands
    from calibration.hand_fit.track import Track
    from clradar.hand import write_pose

    (folder / FRAMES).mkdir(exist_ok=True)
    store = FolderStore(folder / WORK)
    track = Track.from_arrays(store[TRACK]) if TRACK in store else None
    if track is not None and track.frame == numbers[-1]:
        return
    for fit, reached in fit_hands(
        images_of(store), frames=numbers, after=track, progress=progress, **settings
    ):
        if fit.state is not None:
            pose = folder / FRAMES / f"{fit.frame:06d}.toml"
            write_pose(pose, fit.state.pose, force=True)
        write_json(frame_file(folder, fit.frame), fit.to_dict(), force=True)
        if reached is not None:
            store[TRACK] = reached.to_arrays()


def _write(folder: Path, source: Path, numbers: list[int], origin: Mapping[str, Any]) -> None:
    """Write figures and table, and last the JSON file, which marks the folder as finished."""
    from calibration.hand_fit.movement_figure import (
        movement_figure,
        movement_sheet,
        shown_frames,
    )
    from clradar.plot import save_figure

    fits = [_read(folder, number) for number in numbers]
    shown = [fits[i] for i in shown_frames(len(fits))]
    store = FolderStore(folder / WORK)
    pictures = [picture_of(store, fit.frame) for fit in shown]
    save_figure(movement_sheet(shown, pictures), folder / SHEET, force=True)
    title = f"{source.name}: angles and tips, with one standard deviation"
    save_figure(movement_figure(fits, title), folder / FIGURE, force=True)
    write_movement_table(folder / TABLE, fits)
    record = {
        "recording": str(source),
        "frames": [read_json_object(frame_file(folder, number)) for number in numbers],
        **origin,
    }
    write_json(folder / RESULT, record, force=True)


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


def _read(folder: Path, number: int) -> FrameFit:
    from calibration.hand_fit.frame_fit import FrameFit

    path = frame_file(folder, number)
    return FrameFit.from_dict(read_json_object(path), path)


def frame_file(folder: Path, number: int) -> Path:
    """The file with the fit of a frame."""
    return folder / FRAMES / f"{number:06d}.json"

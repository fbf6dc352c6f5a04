"""The fit of a hand to one recording, frame by frame into a folder that resumes."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
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
    from measurement_io import Recording

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
        store = FolderStore(self.folder / WORK)
        track = Track.from_arrays(store[TRACK]) if TRACK in store else None
        if track is not None and track.frame == numbers[-1]:
            return
        images = FrameImages(recording, self.voxels, self.imaging, self.device, store)
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
        pictures = [picture_of(store, fit.frame) for fit in shown]
        save_figure(movement_sheet(shown, pictures), self.folder / SHEET, force=True)
        title = f"{self.source.name}: angles and tips, with one standard deviation"
        save_figure(movement_figure(fits, title), self.folder / FIGURE, force=True)
        write_movement_table(self.folder / TABLE, fits)
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


def _read(folder: Path, number: int) -> FrameFit:
    from calibration.hand_fit.frame_fit import FrameFit

    path = _frame_file(folder, number)
    return FrameFit.from_dict(read_json_object(path), path)


def _frame_file(folder: Path, number: int) -> Path:
    return folder / FRAMES / f"{number:06d}.json"

"""The folder of ``clradar process``: frames are done once, then table, curves and pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.frame_images import KeptImages
from clradar.cli.frame_steps import (
    CAPTURES,
    GRID,
    MAPS,
    RECORDS,
    VOLUMES,
    FrameSteps,
    fixed_name,
    read_record,
    record_file,
)
from clradar.cli.frame_table import curves, table, write_table
from clradar.cli.hand_sequence import fitted, frame_file
from clradar.cli.movement_table import print_sequence
from clradar.cli.on_workers import Cluster, each_made
from clradar.cli.resumable import (
    SETTINGS,
    FolderStore,
    begin_work,
    changed_files,
    clear,
    cleared_on_failure,
)
from clradar.errors import (
    ClradarError,
    ClusterError,
    CompareError,
    DeviceError,
    MeasurementError,
    OutputError,
)
from clradar.files import work_folder
from clradar.files.atomic import write_file
from clradar.files.json_differences import listed_differences
from clradar.files.json_file import read_json_object, write_json
from clradar.opencl import open_devices

RESULT, TABLE, FIGURE, MOVIE, REPORT = (
    "recording.json", "frames.csv", "time-line.png", "movie.gif", "report.html"
)  # fmt: skip
PICTURES = "pictures"

HANDS = "hand"
"""Folder of the fit of a hand, as of ``clradar fit-hand --frames``."""

EMPTY = "empty.h5"
"""The mean of the empty room's frames."""

OWN_NAMES = (
    RESULT, SETTINGS, EMPTY, TABLE, FIGURE, MOVIE, REPORT,
    PICTURES, HANDS, RECORDS, MAPS, CAPTURES, VOLUMES,
)  # fmt: skip
"""Names in the folder that are its own; --force replaces no others. The result goes first, so that
what is left is never taken for finished."""

DEFAULT_STEP_S = 0.1
"""Between the pictures of frames without time stamps."""

MISSED = (DeviceError, OutputError, ClusterError)
"""Errors that are not of a single frame, and end the run."""


@dataclass(slots=True, kw_only=True)
class RecordingWork:
    """A recording, what is done with its frames, and how.

    Attributes
    ----------
    source, folder : Path
    prepare : callable
        Returns the steps of a frame; it is called in the folder once that is begun, and keeps
        there what all frames need.
    groups : sequence of tuple of int
        Numbers of the frames; each group is averaged, and has the number of its first frame.
    files : callable
        The files that a group is made from.
    settings : mapping
        Options that the folder has to have been begun with, without the places of files.
    inputs : mapping
        Files that all frames are made with; see `begin_work`.
    labels : sequence of str
        Of the recording and of the simulations.
    origin : mapping
        From `clradar.cli.provenance.provenance`.
    workers : int, Cluster or None
        Worker processes; None: in this one, or in one for each of several devices.
    device : str or None
        As of `clradar.opencl.open_devices`.
    hand : mapping or None
        Settings of `calibration.fit_hands`: a hand is fitted to the frames.
    force : bool
        Begin anew in a folder that was begun with other settings, and with frames that changed.
    """

    source: Path
    folder: Path
    prepare: Callable[[], FrameSteps]
    groups: Sequence[tuple[int, ...]]
    files: Callable[[Sequence[int]], list[Path]]
    settings: Mapping[str, Any]
    inputs: Mapping[str, Sequence[Path]]
    labels: Sequence[str]
    origin: Mapping[str, Any]
    workers: int | Cluster | None
    device: str | None
    hand: Mapping[str, Any] | None
    force: bool

    def run(self) -> list[dict[str, Any]]:
        """Do the frames that are not done yet, and what is made of all; return their records.

        Raises
        ------
        MeasurementError
            No frame could be done.
        OutputError
            The folder was begun with other settings or inputs, or another process writes into it.
        """
        folder = self.folder
        with work_folder.held(folder, "process"):
            settings = {**self.settings, "clradar": self.origin["clradar"]}
            begin_work(
                folder, settings, own=OWN_NAMES, work="processed recording", force=self.force,
                inputs=self.inputs,
            )  # fmt: skip
            self._check_frames()
            if not self._finished() or len(self._done()) < len(self.groups):
                with cleared_on_failure(folder, OWN_NAMES, unless=f"{RECORDS}/*.json"):
                    with progress_bar("preparing"):
                        steps = self.prepare()
                    self._frames(steps)
                    if not self._done():
                        raise MeasurementError(f"{self.source}: no frame could be processed")
            records = [read_record(folder, number) for number in self._done()]
            if not self._finished():
                if self.hand is not None:
                    records = self._with_hands(steps, records)
                self._write(steps, records)
        return records

    def _check_frames(self) -> None:
        """Raise where frames were made from other files than are there; `force` forgets them."""
        groups = {group[0]: group for group in self.groups}

        def changes(number: int, inputs: Any) -> list[str]:
            name = f"frame {number}:"
            if number not in groups:
                return [f"{name} is no longer there"]
            return changed_files({name: self.files(groups[number])}, {name: inputs})

        store = FolderStore(self.folder / MAPS)
        placed_by = json.loads(str(store[GRID]["placed_by"])) if GRID in store else None
        found = {GRID: changes(placed_by["frame"], placed_by["inputs"])} if placed_by else {}
        records = sorted((self.folder / RECORDS).glob("*.json"))
        with progress_bar("comparing files") as progress:
            for done, path in enumerate(records, start=1):
                inputs = read_json_object(path).get("inputs")
                found[path.stem] = changes(int(path.stem), inputs)
                if progress is not None:
                    progress(done, len(records))
        texts = list(dict.fromkeys(text for words in found.values() for text in words))
        if texts and not self.force:
            raise OutputError(
                f"{self.folder}: was made from other files: {listed_differences(texts, 2)}. Choose "
                "another folder, or make anew what changed with --force"
            )
        if found.get(GRID):  # which all frames are on
            clear(self.folder, [name for name in OWN_NAMES if name not in (SETTINGS, EMPTY)])
        elif texts:
            names = [name for name, words in found.items() if words]
            kept = [f"{where}/{name}.h5" for where in (CAPTURES, VOLUMES) for name in names]
            clear(self.folder, [RESULT, *kept, *(f"{RECORDS}/{name}.json" for name in names)])

    def _finished(self) -> bool:
        """Whether what is made of all frames is there, and no frame was done after it."""
        result = self.folder / RESULT
        if not result.is_file():
            return False
        done = (record_file(self.folder, number) for number in self._done())
        return all(one.stat().st_mtime_ns <= result.stat().st_mtime_ns for one in done)

    def _done(self) -> list[int]:
        firsts = (group[0] for group in self.groups)
        return [first for first in firsts if record_file(self.folder, first).is_file()]

    def _frames(self, steps: FrameSteps) -> None:
        folder = self.folder
        for name in (RECORDS, MAPS, *steps.keep):
            (folder / name).mkdir(exist_ok=True)
        left = [group for group in self.groups if not record_file(folder, group[0]).is_file()]
        if len(left) < len(self.groups):
            there = counted(len(self.groups) - len(left), "frame")
            print_line(f"{folder}: resumes with {there} done before")
        if not left:
            return
        said: set[str] = set()
        with progress_bar("frames") as progress:
            made = each_made(steps, left, self.workers, self.device, "the frames of a folder")
            for done, (group, (outcome, warned)) in enumerate(made, start=1):
                if isinstance(outcome, MISSED):
                    raise outcome
                if isinstance(outcome, ClradarError):
                    warned = [*warned, str(outcome)]
                for text in warned:
                    if text not in said:
                        print_warning(f"frame {group[0]}: {text}")
                    said.add(text)
                if progress is not None:
                    progress(done, len(left))

    def _with_hands(
        self, steps: FrameSteps, records: Sequence[Mapping[str, Any]]
    ) -> list[dict[str, Any]]:
        """The records with the hands that are fitted to their frames.

        Each is fitted from the one before, so that is done by this process alone, whoever did the
        frames; from the depth maps that are kept of them.
        """
        assert self.hand is not None
        numbers = [int(one["frame"]) for one in records]
        times_us = tuple(one["time_us"] for one in records)
        first = steps.capture_of(steps.source, numbers[0], steps.variant)
        settings = {
            **self.hand, "array": first.array, "waveform": first.waveform,
            "device": steps.device or open_devices(self.device).first,
        }  # fmt: skip
        del first
        made_from = [[file["sha256"] for file in one["inputs"]] for one in records]
        begun = {**self.settings, "frames": numbers, "inputs": made_from}
        options = {**self.origin["options"], "frames": numbers}
        folder = self.folder / HANDS
        with work_folder.held(folder, "fit"), progress_bar("fitting the hand") as progress:
            try:
                fits = fitted(
                    folder, self.source,
                    lambda store: KeptImages(tuple(numbers), times_us, steps.hand_map_of, store),
                    numbers, settings, {**self.origin, "options": options}, progress,
                    begun=begun, force=True,
                )  # fmt: skip
            except CompareError as error:
                print_warning(f"{HANDS}: {error}")
                return [dict(one) for one in records]
        print_sequence(folder, fits)
        return [
            {**one, "hand": read_json_object(frame_file(folder, number))}
            for one, number in zip(records, numbers, strict=True)
        ]

    def _write(self, steps: FrameSteps, records: Sequence[Mapping[str, Any]]) -> None:
        """Write what is made of all frames, and last the file that marks it as finished."""
        from clradar.plot import save_figure
        from clradar.plot.frames import FramePictures, curves_figure, write_gif

        folder = self.folder
        clear(folder, [TABLE, FIGURE, MOVIE, REPORT, PICTURES])  # there may have been more frames
        columns = table(records, self.labels[1:])
        write_table(folder / TABLE, columns)
        timed = np.isfinite(columns["time s"]).all()
        time = columns["time s" if timed else "frame"]
        panels = curves(columns)
        title = f"{self.labels[0]}, {counted(len(records), 'frame')}"
        if panels:
            figure = curves_figure(time, panels, "time (s)" if timed else "frame", title)
            save_figure(figure, folder / FIGURE, force=True)
        shown = [one["frame"] for one in records if one["peak_db"] is not None]
        if shown:
            images = (steps.map_of(f"{number:06d}") for number in shown)
            pictures = FramePictures(images, steps.dynamic_range_db)
            (folder / PICTURES).mkdir(exist_ok=True)
            files = []
            with progress_bar("drawing") as progress:
                for i, one in enumerate(records):
                    number = one["frame"]
                    image = steps.map_of(f"{number:06d}") if number in shown else None
                    when = f", {columns['time s'][i]:.3f} s" if timed else ""
                    files.append(folder / PICTURES / f"{i:06d}.png")
                    picture = pictures.png(image, f"{self.labels[0]}, frame {number}{when}")
                    write_file(files[-1], picture, force=True)
                    if progress is not None:
                        progress(i + 1, len(records))
                step_s = float(np.median(np.diff(time))) if timed and len(time) > 1 else 0.0
                write_gif(folder / MOVIE, files, step_s if step_s > 0 else DEFAULT_STEP_S)
        if shown and steps.simulated:
            self._report(steps, records)
        record = {"recording": str(self.source), "frames": list(records), **self.origin}
        write_json(folder / RESULT, record, force=True)

    def _report(self, steps: FrameSteps, records: Sequence[Mapping[str, Any]]) -> None:
        from clradar.report import FrameSeries, frames, frames_report

        series = FrameSeries(list(self.labels), steps.dynamic_range_db)
        store = FolderStore(steps.folder / MAPS)
        every = -(-len(records) // frames.MAX_FRAMES)
        notes = []
        if every > 1:
            nth = {2: "2nd", 3: "3rd"}.get(every, f"{every}th")
            notes = [
                f"every {nth} of {len(records)} frames: a page has at most {frames.MAX_FRAMES}"
            ]
            print_line(f"{REPORT}: {notes[0]}")
        for one in records[::every]:
            name = f"{one['frame']:06d}"
            others = [
                steps.map_of(fixed_name(i) if fixed_name(i) in store else f"{name}-{i}")
                for i in range(len(steps.simulated))
            ]
            try:
                series.add(f"frame {one['frame']}", [steps.map_of(name), *others])
            except CompareError as error:
                print_warning(f"{REPORT}: not written: {error}")
                return
        sources = [str(path) for path in (steps.source, *steps.simulated)]
        page = frames_report(series, sources=sources, notes=notes, settings=steps.origin)
        write_file(steps.folder / REPORT, page.encode("utf-8"), force=True)

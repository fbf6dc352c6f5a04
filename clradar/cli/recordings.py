"""The folder of ``clradar process``: frames are done once, then table, curves and pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.comparison import METRIC_COLUMNS
from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.frames import (
    CAPTURES,
    GRID,
    MAPS,
    RECORDS,
    VOLUMES,
    Frames,
    FrameSteps,
    capture_of,
    cleaned,
    fixed_name,
    map_arrays,
    read_record,
    record_file,
)
from clradar.cli.inputs import grid_for
from clradar.cli.moving_hands import KeptImages, fitted, frame_file, hand_columns, print_sequence
from clradar.cli.options.groups import given
from clradar.cli.options.measured import PAPER_GRID_MM, GridOptions
from clradar.cli.outputs import save
from clradar.cli.sweeps import write_csv
from clradar.errors import (
    ClusterError,
    CompareError,
    DeviceError,
    MeasurementError,
    OutputError,
)
from clradar.files.atomic import write_file
from clradar.files.json_differences import listed_differences
from clradar.files.json_file import read_json_object, write_json
from clradar.jobs import FolderStore, Job, Where, open_devices
from clradar.jobs.job import KEY, changed_files, remove

if TYPE_CHECKING:
    from clradar import VoxelGrid

RESULT, TABLE, FIGURE, MOVIE = "recording.json", "frames.csv", "time-line.png", "movie.gif"
PICTURES = "pictures"

HANDS = "hand"
"""Folder of the fit of a hand."""

EMPTY = "empty.h5"
"""The mean of the empty room's frames."""

OWN_NAMES = (
    RESULT, KEY, EMPTY, TABLE, FIGURE, MOVIE,
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
    """A recording, what is done with its frames, and how."""

    source: Path
    folder: Path
    prepare: Callable[[], FrameSteps]  # called once the folder is begun
    groups: Sequence[tuple[int, ...]]  # each is averaged, and has the number of its first
    files: Callable[[Sequence[int]], list[Path]]
    settings: Mapping[str, Any]  # options without the places of files
    inputs: Mapping[str, Sequence[Path]]  # that all frames are made with
    labels: Sequence[str]
    origin: Mapping[str, Any]
    where: Where
    hand: Mapping[str, Any] | None  # settings of `calibration.fit_hands`
    force: bool

    def run(self) -> list[dict[str, Any]]:
        """Do the frames that are not done yet, and what is made of all; return their records."""
        folder = self.folder
        job = Job(
            folder=folder, work="processed recording", own=OWN_NAMES, inputs=self.inputs,
            key={**self.settings, "clradar": self.origin["clradar"]}, force=self.force,
            resumable=lambda folder: any(folder.glob(f"{RECORDS}/*.json")),
        )  # fmt: skip
        with job.held():
            self._check_frames()
            if not self._finished() or len(self._done()) < len(self.groups):
                with progress_bar("preparing"):
                    steps = self.prepare()
                self._frames(job, steps)
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
            remove(self.folder, [name for name in OWN_NAMES if name not in (KEY, EMPTY)])
        elif texts:
            names = [name for name, words in found.items() if words]
            kept = [f"{where}/{name}.h5" for where in (CAPTURES, VOLUMES) for name in names]
            remove(self.folder, [RESULT, *kept, *(f"{RECORDS}/{name}.json" for name in names)])

    def _finished(self) -> bool:
        """Whether what is made of all frames is there: it goes before any frame is done."""
        return (self.folder / RESULT).is_file()

    def _done(self) -> list[int]:
        firsts = (group[0] for group in self.groups)
        return [first for first in firsts if record_file(self.folder, first).is_file()]

    def _frames(self, job: Job, steps: FrameSteps) -> None:
        job.clear([RESULT])
        for name in (RECORDS, MAPS, *steps.keep):
            (self.folder / name).mkdir(exist_ok=True)
        with progress_bar("frames") as progress:
            for _ in job.each(
                steps, self.groups, self.where,
                done=lambda group: record_file(self.folder, group[0]).is_file(),
                name=lambda group: f"frame {group[0]}: ",
                tolerated=lambda error: not isinstance(error, MISSED),
                progress=progress, say=print_line, noun="frame",
            ):  # fmt: skip
                pass

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
        first = steps.capture_of(steps.source, numbers[0], steps.chosen.variant)
        settings = {
            **self.hand, "array": first.array, "waveform": first.waveform,
            "device": steps.device or open_devices(self.where.device).first,
        }  # fmt: skip
        del first
        made_from = [[file["sha256"] for file in one["inputs"]] for one in records]
        begun = {**self.settings, "frames": numbers, "inputs": made_from}
        options = {**self.origin["options"], "frames": numbers}
        folder = self.folder / HANDS
        with progress_bar("fitting the hand") as progress:
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
        remove(folder, [TABLE, FIGURE, MOVIE, PICTURES])  # there may have been more frames
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
            pictures = FramePictures(images, steps.depth.dynamic_range_db)
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
        record = {"recording": str(self.source), "frames": list(records), **self.origin}
        write_json(folder / RESULT, record, force=True)


def prepared(
    steps: Callable[..., FrameSteps], groups: Sequence[tuple[int, ...]], voxels: GridOptions
) -> FrameSteps:
    """The steps of a frame, with what all frames need in their folder.

    `steps` lacks the grid, which the first group that can be read places without ranges in the
    options.
    """
    from calibration import average_frames
    from clradar import VoxelGrid

    found = steps(grid=voxels.grid(PAPER_GRID_MM))
    empty = found.cleaning.empty
    if empty is not None and empty.is_dir() and found.cleaning.empty_by == "mean":
        mean = found.folder / EMPTY
        if not mean.is_file():
            room = Frames.open(empty)
            frames = (capture_of(room, number) for number in room.numbers or ())
            save(mean, average_frames(frames), found.origin, force=True)
        found = replace(found, cleaning=replace(found.cleaning, empty=mean))
    store = FolderStore(found.folder / MAPS)
    if GRID not in store:  # kept: another first frame may be readable when the run is resumed
        grid, placed_by = _grid(found, groups, voxels)
        store[GRID] = {
            "origin_m": grid.origin_m, "spacing_m": grid.spacing_m, "counts": np.array(grid.counts),
            "placed_by": np.array(json.dumps(placed_by)),
        }  # fmt: skip
    kept = store[GRID]
    counts = kept["counts"].tolist()
    found = replace(found, grid=VoxelGrid(kept["origin_m"], kept["spacing_m"], counts))
    for i, path in enumerate(found.simulated):
        source = Frames.open(path)
        if source.numbers is None and fixed_name(i) not in store:
            store[fixed_name(i)] = map_arrays(found.imaged(source.read(0)))
    return found


def _grid(
    steps: FrameSteps, groups: Sequence[tuple[int, ...]], voxels: GridOptions
) -> tuple[VoxelGrid, dict[str, Any]]:
    """The grid of the options, or that of the first frame that can be read, with what placed it."""
    if given(voxels):
        return voxels.grid(), {}
    failure: MeasurementError | None = None
    for group in groups:
        try:
            placed_by = {"frame": group[0], "inputs": steps.inputs_of(group)}
            capture, _ = cleaned(steps, group)
        except MeasurementError as error:
            failure = failure or error
            continue  # which is said when its turn comes
        return grid_for(capture, voxels, steps.device), placed_by
    assert failure is not None  # there is at least one frame
    raise failure


def print_summary(work: RecordingWork, records: Sequence[dict[str, Any]]) -> None:
    """Say what is in the folder."""
    missing = len(work.groups) - len(records)
    print_line(f"{work.folder / TABLE}: {counted(len(records), 'frame')}")
    print_line(f"{work.folder / RESULT}: the same with all metrics, and how they were made")
    if (work.folder / MOVIE).is_file():
        print_line(f"{work.folder / MOVIE}: the animation; its pictures are in pictures/")
    if missing:
        raise MeasurementError(
            f"{work.source}: {missing} of {len(work.groups)} frames could not be processed; "
            f"{work.folder} has the others"
        )


Record = Mapping[str, Any]

LEVELS = {"peak dB": "peak_db", "recorded RMS dB": "recorded_db", "cleaned RMS dB": "cleaned_db"}


def table(records: Sequence[Record], labels: Sequence[str]) -> dict[str, np.ndarray]:
    """The columns of the table by name, each of shape (n,), float64; NaN where there is none."""
    stamps = _column(records, lambda one: one["time_us"])
    start = stamps[np.isfinite(stamps)][:1]
    found = {
        "frame": _column(records, lambda one: one["frame"]),
        "time s": (stamps - start) / 1e6 if start.size else stamps,
    }
    found |= {name: _column(records, lambda one, key=key: one[key]) for name, key in LEVELS.items()}
    for what in ("peak", "centre"):
        for i, axis in enumerate("xyz"):
            found[f"{what} {axis} mm"] = _column(
                records,
                lambda one, key=f"{what}_m", i=i: 1e3 * one[key][i],
            )
    for i, label in enumerate(labels):
        for name, (key, scale, _) in METRIC_COLUMNS.items():
            found[f"{label}: {name}" if len(labels) > 1 else name] = _column(
                records,
                lambda one, i=i, key=key, scale=scale: scale * one["metrics"][i][key],
            )
    if any("alignment" in one for one in records):
        found |= _motion(records)
    if any("hand" in one for one in records):
        from calibration.hand_fit.frame_fit import FrameFit

        fits = (one.get("hand") for one in records)
        found |= hand_columns([fit and FrameFit.from_dict(fit, Path("hand")) for fit in fits])
    return found


def _column(records: Sequence[Record], value: Any) -> np.ndarray:
    values = []
    for one in records:
        try:
            found = value(one)
        except (KeyError, TypeError):  # a frame without an image, or that could not be aligned
            found = None
        values.append(np.nan if found is None else float(found))
    return np.array(values)


def _motion(records: Sequence[Record]) -> dict[str, np.ndarray]:
    """Rotation and translation of the aligned mesh, about its centre in the first frame."""
    from scipy.spatial.transform import Rotation

    rows = np.full((len(records), 8), np.nan)
    about: np.ndarray | None = None
    for row, one in zip(rows, records, strict=True):
        if "transform" not in one.get("alignment", {}):
            continue
        matrix = np.asarray(one["alignment"]["transform"], np.float64)
        if about is None:
            centre_m = np.asarray(one["alignment"]["centre_m"], np.float64)
            about = matrix[:3, :3].T @ (centre_m - matrix[:3, 3])
            first = matrix
        row[:3] = 1e3 * (matrix[:3, :3] @ about + matrix[:3, 3])
        row[3:6] = np.degrees(Rotation.from_matrix(matrix[:3, :3] @ first[:3, :3].T).as_rotvec())
        row[6:] = one["alignment"]["inlier_share"], 1e3 * one["alignment"]["rms_m"]
    names = [f"mesh {axis} mm" for axis in "xyz"] + [f"mesh turn {axis} deg" for axis in "xyz"]
    return dict(zip([*names, "mesh inliers", "mesh rms mm"], rows.T, strict=True))


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write one row per frame; cells without a value are empty."""
    rows = zip(*(map(_cell, values) for values in columns.values()), strict=True)
    write_csv(path, list(columns), rows)


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.10g}"


def curves(columns: Mapping[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """What is drawn over time: axis name -> curve -> values; without what has no value."""
    cleaned, recorded = columns["cleaned RMS dB"], columns["recorded RMS dB"]
    levels = ["recorded RMS dB", "cleaned RMS dB"]
    if np.array_equal(cleaned, recorded, equal_nan=True):  # nothing was cleaned
        levels.pop()
    # One axis each: 300 mm of depth would flatten everything else.
    panels = {"peak (dB)": ["peak dB"], "RMS (dB)": levels}
    for what in ("centre", "mesh"):
        panels |= {f"{what} {axis} (mm)": [f"{what} {axis} mm"] for axis in "xyz"}
    panels["mesh turned (deg)"] = [f"mesh turn {axis} deg" for axis in "xyz"]
    for metric in ("overlap", "depth RMSE (mm)"):
        panels[metric] = [name for name in columns if name.endswith(metric)]
    drawn: dict[str, dict[str, np.ndarray]] = {}
    for panel, names in panels.items():
        there = {n: columns[n] for n in names if n in columns and np.isfinite(columns[n]).any()}
        if there:
            drawn[panel] = there
    return drawn

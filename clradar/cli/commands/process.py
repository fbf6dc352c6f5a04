"""``clradar process``: all frames of a recording, done once, then table, curves and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np

import calibration
import clradar as cl
from clradar.cli import console, images as img, options as opt, outputs as out
from clradar.cli.frames import (
    CAPTURES,
    MAPS,
    RECORDS,
    VOLUMES,
    Frames,
    FrameSteps,
    ProcessOptions,
    listed,
    record_file,
)
from clradar.cli.parse import chosen_frames
from clradar.compare.images import depth_map_of
from clradar.compare.metrics import METRIC_TABLE
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ClusterError, CompareError, DeviceError, MeasurementError, OutputError
from clradar.files.atomic import write_file
from clradar.files.failures import fail
from clradar.files.json_file import read_json_object, write_json
from clradar.jobs import KEY, FolderStore, remove
from clradar.model.progress import Progress

# Names in the folder.
RESULT, TABLE, FIGURE, MOVIE = "recording.json", "frames.csv", "time-line.png", "movie.gif"
PICTURES = "pictures"
EMPTY = "empty.h5"  # the mean of the empty room's frames
GRID = "grid"  # among the maps
HANDS, WORK = "hand", "work"  # the fit of a hand, with records as of all frames; resumes by WORK
MOVEMENT, SHEET = "movement.png", "contact-sheet.png"
TRACK, NUMBERS = "track", "numbers"  # in WORK: what is remembered after the last frame; all frames

OWN_NAMES = (
    RESULT, KEY, EMPTY, TABLE, FIGURE, MOVIE,
    PICTURES, f"{HANDS}/{RECORDS}", f"{HANDS}/{WORK}", HANDS, RECORDS, MAPS, CAPTURES, VOLUMES,
)  # fmt: skip
"""Names in the folder that are its own; --force replaces no others. The result goes first, so that
what is left is never taken for finished."""

DEFAULT_STEP_S = 0.1  # between the pictures of frames without time stamps

MISSED = (DeviceError, OutputError, ClusterError)
"""Errors that are not of a single frame, and end the run."""

Record = Mapping[str, Any]


def prepared(
    steps: FrameSteps, numbers: Sequence[int], voxels: opt.GridOptions, device: cl.Device
) -> FrameSteps:
    """The steps with what all frames need: the mean of the empty room, the grid."""
    folder = steps.folder
    kept = [CAPTURES] * steps.how.keep_captures + [VOLUMES] * steps.how.keep_volumes
    for name in (RECORDS, MAPS, *kept):
        (folder / name).mkdir(exist_ok=True)
    if steps.how.empty is not None and steps.how.empty.is_dir():
        mean = folder / EMPTY
        if not mean.is_file():
            room = Frames(steps.how.empty)
            frames = map(room.capture, console.track(room.files, "averaging"))
            out.save(mean, calibration.average_frames(frames), steps.origin)
        steps = replace(steps, how=replace(steps.how, empty=mean))
    store = FolderStore(folder / MAPS)
    if GRID not in store:  # kept: another first frame may be readable when the run is resumed
        grid = voxels.grid() if opt.given(voxels) else _placed(steps, numbers, voxels, device)
        arrays = {"origin_m": grid.origin_m, "spacing_m": grid.spacing_m}
        store[GRID] = {**arrays, "counts": np.array(grid.counts)}
    known = store[GRID]
    grid = cl.VoxelGrid(known["origin_m"], known["spacing_m"], known["counts"].tolist())
    return replace(steps, grid=grid)


def _placed(
    steps: FrameSteps, numbers: Sequence[int], voxels: opt.GridOptions, device: cl.Device
) -> cl.VoxelGrid:
    """The grid by the first frame that can be read."""
    failures = []
    for number in numbers:
        try:
            capture, _ = steps.cleaned(number)
        except MeasurementError as error:
            failures.append(error)  # which is said when its turn comes
            continue
        return img.grid_for(capture, voxels, device)
    raise failures[0]


def hands_of(
    steps: FrameSteps, source: Frames, records: Sequence[Record], **settings: Any
) -> list[calibration.FrameFit] | None:
    """The hands of the frames, each fitted from the one before, here; None if impossible."""
    from calibration.hand_fit.frame_fit import FOLLOWED

    numbers = [int(one["frame"]) for one in records]
    images = img.ReadOnAccess(
        numbers, lambda number: steps.map_of(f"{number:06d}-hand"),
        [one["time_us"] for one in records],
    )  # fmt: skip
    first = source.capture(numbers[0])
    settings |= {"array": first.array, "waveform": first.waveform}
    del first
    folder = steps.folder / HANDS
    with console.bar("fitting the hand") as progress:
        try:
            fits = fit_frames(folder, images, settings, progress)
        except CompareError as error:
            console.warning(f"{HANDS}: {error}")
            return None
    followed = sum(fit.how == FOLLOWED for fit in fits)
    lost = sum(fit.state is None for fit in fits)
    words = f"{len(fits)} frames, {followed} followed, {len(fits) - followed - lost} searched"
    console.line(f"{folder}: {words}" + (f", {lost} without a hand" if lost else ""))
    draw_movement(folder, images, fits, source.path.name)
    return fits


def write_results(
    steps: FrameSteps,
    labels: Sequence[str],
    records: Sequence[dict[str, Any]],
    fits: Sequence[calibration.FrameFit] | None,
) -> None:
    """Write what is made of all frames, and last the file that marks it as finished."""
    from clradar.plot.captures import FramePictures, curves_figure, write_gif

    folder = steps.folder
    remove(folder, [TABLE, FIGURE, MOVIE, PICTURES])  # there may have been more frames
    columns = table(records, labels[1:])
    if fits is not None:
        columns |= hand_columns(fits)
        for one in records:
            one["hand"] = read_json_object(record_file(folder / HANDS, one["frame"]))
    cells = (["" if np.isnan(v) else f"{v:.10g}" for v in row] for row in columns.values())
    img.write_csv(folder / TABLE, list(columns), zip(*cells, strict=True))
    timed = bool(np.isfinite(columns["time s"]).all())
    time = columns["time s" if timed else "frame"]
    title = f"{labels[0]}, {console.counted(len(records), 'frame')}"
    if panels := curves(columns):
        figure = curves_figure(time, panels, "time (s)" if timed else "frame", title)
        out.write(folder / FIGURE, figure, force=True)
    shown = [one["frame"] for one in records if one["peak_db"] is not None]
    if shown:
        images = (steps.map_of(f"{number:06d}") for number in shown)
        pictures = FramePictures(images, steps.how.dynamic_range_db)
        (folder / PICTURES).mkdir(exist_ok=True)
        files = [folder / PICTURES / f"{i:06d}.png" for i in range(len(records))]
        for i, file in enumerate(console.track(files, "drawing")):
            number = records[i]["frame"]
            image = steps.map_of(f"{number:06d}") if number in shown else None
            when = f", {columns['time s'][i]:.3f} s" if timed else ""
            picture = pictures.png(image, f"{labels[0]}, frame {number}{when}")
            write_file(file, picture, force=True)
        step_s = float(np.median(np.diff(time))) if timed and len(time) > 1 else 0.0
        write_gif(folder / MOVIE, files, step_s if step_s > 0 else DEFAULT_STEP_S)
    record = {"recording": str(steps.source), "frames": records}
    out.write(folder / RESULT, record, force=True)


def table(records: Sequence[Record], labels: Sequence[str]) -> dict[str, np.ndarray]:
    """The columns of the table by name, each of shape (n,), float64; NaN where there is none."""
    rows = [_row(one, labels) for one in records]
    found = {name: np.array([row[name] for row in rows], np.float64) for name in rows[0]}
    stamps = found["time s"]
    found["time s"] = (stamps - [*stamps[np.isfinite(stamps)], 0.0][0]) / 1e6
    return found | (_motion(records) if any("alignment" in one for one in records) else {})


def _row(record: Record, labels: Sequence[str]) -> dict[str, float | None]:
    row = {"frame": record["frame"], "time s": record["time_us"]}
    for name in ("peak", "recorded RMS", "cleaned RMS"):
        row[f"{name} dB"] = record[f"{name.removesuffix(' RMS')}_db"]
    for what in ("peak", "centre"):
        for axis, place_m in zip("xyz", record[f"{what}_m"] or 3 * [np.nan], strict=True):
            row[f"{what} {axis} mm"] = 1e3 * place_m
    for label, metrics in zip(labels, record["metrics"], strict=True):
        for metric in METRIC_TABLE:
            value = (metrics or {}).get(metric.field)
            name = f"{label}: {metric.name}" if len(labels) > 1 else metric.name
            row[name] = None if value is None else metric.scale * value
    return row


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
    there = {
        panel: {n: columns[n] for n in names if n in columns and np.isfinite(columns[n]).any()}
        for panel, names in panels.items()
    }
    return {panel: drawn for panel, drawn in there.items() if drawn}


def fit_frames(
    folder: Path,
    images: img.ReadOnAccess,
    settings: Mapping[str, Any],
    progress: Progress | None,
) -> list[calibration.FrameFit]:
    """Fit a hand to frames that are not done yet, each from the one before; of others anew."""
    from calibration.hand_fit.track import Track

    numbers = images.frame_numbers
    folder.mkdir(exist_ok=True)
    store = FolderStore(folder / WORK)
    if NUMBERS not in store or store[NUMBERS]["frames"].tolist() != list(numbers):
        remove(folder, [WORK, RECORDS, MOVEMENT, SHEET])
        store = FolderStore(folder / WORK)
        store[NUMBERS] = {"frames": np.array(numbers)}
    (folder / RECORDS).mkdir(exist_ok=True)
    track = Track.from_arrays(store[TRACK]) if TRACK in store else None
    if track is None or track.frame != numbers[-1]:
        for fit, reached in calibration.fit_hands(
            images, frames=list(numbers), after=track, progress=progress, **settings
        ):
            if fit.state is not None:
                pose = folder / RECORDS / f"{fit.frame:06d}.toml"
                cl.hand.write_pose(pose, fit.state.pose, force=True)
            write_json(record_file(folder, fit.frame), fit.to_dict(), force=True)
            if reached is not None:
                store[TRACK] = reached.to_arrays()
    files = [record_file(folder, number) for number in numbers]
    return [calibration.FrameFit.from_dict(read_json_object(file), file) for file in files]


def draw_movement(
    folder: Path, images: img.ReadOnAccess, fits: Sequence[calibration.FrameFit], name: str
) -> None:
    from calibration.hand_fit.movement_figure import movement_figure, movement_sheet, shown_frames

    shown = shown_frames(len(fits))
    pictures = [_picture(images[i]) for i in shown]
    out.write(folder / SHEET, movement_sheet([fits[i] for i in shown], pictures), force=True)
    title = f"{name}: angles and tips, with one standard deviation"
    out.write(folder / MOVEMENT, movement_figure(fits, title), force=True)


def _picture(image: cl.DepthMap) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """A picture of a frame's maxima, if there is anything above zero."""
    try:
        seen = depth_map_of(image, DYNAMIC_RANGE_DB, "image")
    except CompareError:
        return None
    return seen.amplitude / seen.amplitude.max(), seen.x_m, seen.y_m


def hand_columns(fits: Sequence[calibration.FrameFit]) -> dict[str, np.ndarray]:
    """Columns of the table: tips in millimetres, angles in degrees, shape; NaN without a hand."""
    from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES
    from calibration.hand_fit.hand_state import angles_of
    from calibration.hand_fit.result import ANGLE_NAMES, DIGITS

    tips = [f"{digit} tip {axis} mm" for digit in DIGITS for axis in (*"xyz", "sd")]
    angles = [f"{name} {what}" for name in ANGLE_NAMES for what in ("deg", "sd deg")]
    names = ["misfit per cell", *tips, *angles, "length mm", "breadth mm", *SHAPE_NAMES[2:]]
    rows = np.full((len(fits), len(names)), np.nan)
    for row, fit in zip(rows, fits, strict=True):
        if fit.state is None:
            continue
        shape = fit.state.shape
        tips_mm = 1e3 * np.column_stack([fit.tips_m, fit.tip_std_m])
        angles_deg = np.degrees(np.column_stack([angles_of(fit.state.pose), fit.angle_std_rad]))
        row[:] = [
            round(fit.misfit_per_cell, 4),
            *(round(value, 3) for value in tips_mm.ravel().tolist()),
            *(round(value, 3) for value in angles_deg.ravel().tolist()),
            *(round(1e3 * value, 2) for value in (shape.length_m, shape.breadth_m)),
            *(round(value, 4) for value in (*shape.finger_lengths, shape.girth)),
        ]
    return {f"hand {name}": values for name, values in zip(names, rows.T, strict=True)}


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
    out.check_folder(output, OWN_NAMES, resumed=True)
    source = Frames(recording, how.variant)
    if not source.files:
        raise opt.wrong_usage("RECORDING", "expected a radar folder, or a folder of captures (.h5)")
    numbers, compared = chosen_frames(how.frames, [*source.files]), list(map(Frames, others))
    for frames in compared:
        if missing := [n for n in numbers if frames.files and n not in frames.files]:
            fail(frames.path, f"the frames of '{recording}'", f"none of number {listed(missing)}")
    starts = [] if how.fit_hand is None else opt.starts_in(how.fit_hand)
    hand = None if how.fit_hand is None else how.settings(how.fit_hand)
    where = processes.where(device)
    read = {"RECORDING": source.files_of(numbers)}
    read["SIMULATED"] = [file for frames in compared for file in frames.files_of(numbers)]
    if how.empty is not None:
        read["--empty"] = Frames(how.empty).files_of()
    steps = FrameSteps(
        source=recording, run_name=token_hex(), folder=output, how=how, simulated=others,
        grid=voxels.grid(), origin=out.provenance(),
    )  # fmt: skip
    labels = [recording.name or str(recording), *img.figure_labels(others, [{} for _ in others])]
    job = out.begun(
        output, "processed recording", OWN_NAMES, f"{RECORDS}/*.json", read=read, numbers=numbers,
        simulated=[path.is_dir() for path in others],
        # Those in files count by their content.
        fit_hand=[None if path else one for one, path in starts] or None,
    )  # fmt: skip

    def is_done(number: int) -> bool:
        return record_file(output, number).is_file()

    with job.held():
        finished = (output / RESULT).is_file()  # it goes before any frame is done
        if not finished or not all(map(is_done, numbers)):
            job.clear([RESULT])
            steps = prepared(steps, numbers, voxels, where.first)
            with console.bar("frames") as progress:
                for _ in job.each(
                    steps.run, numbers, where, done=is_done,
                    name=lambda number: f"frame {number}: ",
                    tolerated=lambda error: not isinstance(error, MISSED),
                    progress=progress, say=console.line, noun="frame",
                ):  # fmt: skip
                    pass
        files = [record_file(output, number) for number in filter(is_done, numbers)]
        if not files:
            raise MeasurementError(f"{recording}: no frame could be processed")
        records = list(map(read_json_object, files))
        if not (output / RESULT).is_file():
            fits = None
            if hand is not None:
                fits = hands_of(steps, source, records, device=where.first, **hand)
            write_results(steps, labels, records, fits)
        job.clear([f"{HANDS}/{WORK}"])
    texts = {
        TABLE: console.counted(len(records), "frame"), FIGURE: "the same over time",
        RESULT: "the same with all metrics, and how they were made",
        MOVIE: "the animation; its pictures are in pictures/",
    }  # fmt: skip
    for path in (output / name for name in texts if (output / name).is_file()):
        console.line(f"{path}: {texts[path.name]}")
    if missing := len(numbers) - len(records):
        raise MeasurementError(
            f"{recording}: {missing} of {len(numbers)} frames could not be processed; {output} has "
            "the others"
        )

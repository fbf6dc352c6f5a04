"""A hand that is fitted to the frames of a recording: its folder, tables and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.console import print_line, print_table
from clradar.cli.sweeps import write_csv
from clradar.errors import CompareError
from clradar.files.json_file import read_json_object, write_json
from clradar.jobs import FolderStore, Job
from clradar.jobs.job import KEY

if TYPE_CHECKING:
    from calibration.hand_fit.frame_fit import FrameFit
    from calibration.hand_fit.movement_figure import Picture
    from clradar import DepthMap, Volume
    from clradar.model.progress import Progress

FRAMES, WORK = "frames", "work"
RESULT, TABLE, FIGURE, SHEET = "movement.json", "movement.csv", "movement.png", "contact-sheet.png"

OWN_NAMES = (KEY, RESULT, TABLE, FIGURE, SHEET, FRAMES, WORK)
"""Names in the folder that are its own; --force replaces no others."""

TRACK = "track"
"""In the work folder, with the image of every frame: what is remembered after the last one."""


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
    """Fit frames into a folder, those that are not done yet; then table and figures."""
    job = Job(
        folder=folder, work="fit of a moving hand", own=OWN_NAMES, force=force,
        key={**begun, "clradar": origin["clradar"]},
        resumable=lambda folder: (folder / WORK / f"{TRACK}.npz").is_file(),
    )  # fmt: skip
    with job.held():
        if not (folder / RESULT).is_file():
            _fit(folder, images_of, numbers, settings, progress)
            _write(folder, source, numbers, origin)
        job.clear([WORK])
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


def _read(folder: Path, number: int) -> FrameFit:
    from calibration.hand_fit.frame_fit import FrameFit

    path = frame_file(folder, number)
    return FrameFit.from_dict(read_json_object(path), path)


def frame_file(folder: Path, number: int) -> Path:
    """The file with the fit of a frame."""
    return folder / FRAMES / f"{number:06d}.json"


ABOUT = ("frame", "time s", "how", "notes")
"""Columns that are no numbers of the hand."""


def write_movement_table(path: Path, fits: Sequence[FrameFit]) -> None:
    """Write one row per frame: time, tips in millimetres, angles in degrees, shape."""
    write_csv(path, _columns(), map(_row, fits))


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


def hand_columns(fits: Sequence[FrameFit | None]) -> dict[str, np.ndarray]:
    """The columns of numbers, each of shape (n,), float64; NaN where there is no hand."""
    names = _columns()
    kept = [i for i, name in enumerate(names) if name not in ABOUT]
    values = np.full((len(fits), len(kept)), np.nan)
    for row, fit in zip(values, fits, strict=True):
        if fit is not None and fit.state is not None:
            cells = _row(fit)
            row[:] = [np.nan if cells[i] == "" else cells[i] for i in kept]
    return {f"hand {names[i]}": values[:, j] for j, i in enumerate(kept)}


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


SHEET_PIXEL_M = 2e-3


@dataclass(frozen=True, slots=True)
class KeptImages(Sequence["DepthMap"]):
    """Depth maps of frames, read on access; their maxima are kept in a store."""

    frame_numbers: tuple[int, ...]
    times_us: tuple[float | None, ...]
    read: Callable[[int], DepthMap]
    store: FolderStore

    def __len__(self) -> int:
        return len(self.frame_numbers)

    def time_us(self, index: int) -> float | None:
        """The time stamp of a frame, which depth maps do not have."""
        return self.times_us[index]

    def __getitem__(self, index: Any) -> Any:
        number = self.frame_numbers[index]
        seen = self.read(number)
        keep_picture(self.store, number, seen)
        return seen


def keep_picture(store: FolderStore, number: int, image: Volume | DepthMap) -> None:
    """Keep a thin picture of a frame's maxima, if there is anything above zero."""
    from clradar.compare import depth_map_of
    from clradar.constants import DYNAMIC_RANGE_DB

    try:
        seen = depth_map_of(image, DYNAMIC_RANGE_DB, "image")
    except CompareError:
        return
    thin = slice(None, None, max(1, round(SHEET_PIXEL_M / float(seen.x_m[1] - seen.x_m[0]))))
    amplitude = seen.amplitude[thin, thin] / seen.amplitude.max()
    store[f"{number:06d}"] = {
        "amplitude": amplitude.astype(np.float32), "x_m": seen.x_m[thin], "y_m": seen.y_m[thin],
    }  # fmt: skip


def picture_of(store: FolderStore, number: int) -> Picture | None:
    """The picture of a frame; None where it could not be imaged."""
    name = f"{number:06d}"
    if name not in store:
        return None
    arrays = store[name]
    return arrays["amplitude"], arrays["x_m"], arrays["y_m"]

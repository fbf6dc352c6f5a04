"""A hand that is fitted to the frames of a recording: what is kept, columns and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.console import print_line, print_table
from clradar.errors import CompareError
from clradar.files.json_file import read_json_object, write_json
from clradar.jobs import FolderStore
from clradar.jobs.job import remove
from clradar.model.progress import Progress

if TYPE_CHECKING:
    from calibration.hand_fit.frame_fit import FrameFit
    from calibration.hand_fit.movement_figure import Picture

FRAMES, WORK = "frames", "work"
FIGURE, SHEET = "movement.png", "contact-sheet.png"

TRACK, NUMBERS = "track", "numbers"
"""In the work folder: what is remembered after the last frame, and of which frames."""

SHEET_PIXEL_M = 2e-3


@dataclass(frozen=True, slots=True)
class KeptImages(Sequence["cl.DepthMap"]):
    """Depth maps of frames, read on access."""

    frame_numbers: Sequence[int]
    times_us: Sequence[float | None]
    read: Callable[[int], cl.DepthMap]

    def __len__(self) -> int:
        return len(self.frame_numbers)

    def time_us(self, index: int) -> float | None:
        """The time stamp of a frame, which depth maps do not have."""
        return self.times_us[index]

    def __getitem__(self, index: Any) -> Any:
        return self.read(self.frame_numbers[index])


def fit_frames(
    folder: Path,
    images: KeptImages,
    settings: Mapping[str, Any],
    progress: Progress | None,
) -> list[FrameFit]:
    """Fit a hand to frames that are not done yet, each from the one before; of others anew."""
    import calibration
    from calibration.hand_fit.frame_fit import FrameFit
    from calibration.hand_fit.track import Track
    from clradar.hand import write_pose

    numbers = images.frame_numbers
    folder.mkdir(exist_ok=True)
    store = FolderStore(folder / WORK)
    if NUMBERS not in store or store[NUMBERS]["frames"].tolist() != list(numbers):
        remove(folder, [WORK, FRAMES, FIGURE, SHEET])
        store = FolderStore(folder / WORK)
        store[NUMBERS] = {"frames": np.array(numbers)}
    (folder / FRAMES).mkdir(exist_ok=True)
    track = Track.from_arrays(store[TRACK]) if TRACK in store else None
    if track is None or track.frame != numbers[-1]:
        for fit, reached in calibration.fit_hands(
            images, frames=list(numbers), after=track, progress=progress, **settings
        ):
            if fit.state is not None:
                pose = folder / FRAMES / f"{fit.frame:06d}.toml"
                write_pose(pose, fit.state.pose, force=True)
            write_json(fit_file(folder, fit.frame), fit.to_dict(), force=True)
            if reached is not None:
                store[TRACK] = reached.to_arrays()
    files = [fit_file(folder, number) for number in numbers]
    return [FrameFit.from_dict(read_json_object(file), file) for file in files]


def fit_file(folder: Path, number: int) -> Path:
    """The file with the fit of a frame."""
    return folder / FRAMES / f"{number:06d}.json"


def draw_movement(folder: Path, images: KeptImages, fits: Sequence[FrameFit], name: str) -> None:
    """Write the figures of the fits."""
    import clradar.plot as plot
    from calibration.hand_fit.movement_figure import movement_figure, movement_sheet, shown_frames

    shown = shown_frames(len(fits))
    pictures = [_picture(images[i]) for i in shown]
    sheet = movement_sheet([fits[i] for i in shown], pictures)
    plot.save_figure(sheet, folder / SHEET, force=True)
    title = f"{name}: angles and tips, with one standard deviation"
    plot.save_figure(movement_figure(fits, title), folder / FIGURE, force=True)


def _picture(image: cl.DepthMap) -> Picture | None:
    """A thin picture of a frame's maxima, if there is anything above zero."""
    from clradar.compare import depth_map_of
    from clradar.constants import DYNAMIC_RANGE_DB

    try:
        seen = depth_map_of(image, DYNAMIC_RANGE_DB, "image")
    except CompareError:
        return None
    thin = slice(None, None, max(1, round(SHEET_PIXEL_M / float(seen.x_m[1] - seen.x_m[0]))))
    amplitude = seen.amplitude[thin, thin] / seen.amplitude.max()
    return amplitude.astype(np.float32), seen.x_m[thin], seen.y_m[thin]


def hand_columns(fits: Sequence[FrameFit]) -> dict[str, np.ndarray]:
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

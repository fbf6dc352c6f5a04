"""What the frames of ``clradar process`` share: empty room, voxel grid, fixed simulations."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.console import counted, print_line
from clradar.cli.frame_sources import Frames
from clradar.cli.frame_steps import (
    GRID,
    MAPS,
    FrameSteps,
    capture_of,
    cleaned,
    fixed_name,
    map_arrays,
)
from clradar.cli.inputs import grid_for
from clradar.cli.options.groups import given
from clradar.cli.options.imaging import PAPER_GRID_MM, GridOptions
from clradar.cli.outputs import save
from clradar.cli.recording_work import EMPTY, MOVIE, RESULT, TABLE, RecordingWork
from clradar.cli.resumable import FolderStore
from clradar.errors import MeasurementError

if TYPE_CHECKING:
    from clradar import VoxelGrid


def prepared(
    steps: Callable[..., FrameSteps],
    empty: Path | None,
    groups: Sequence[tuple[int, ...]],
    voxels: GridOptions,
) -> FrameSteps:
    """The steps of a frame, with what all frames need in their folder.

    Parameters
    ----------
    steps : callable
        `FrameSteps` but for `empty` and `grid`.
    empty : Path or None
    groups : sequence of tuple of int
        The first that can be read places the grid, without ranges in the options.
    voxels : GridOptions
    """
    from calibration import average_frames
    from clradar import VoxelGrid

    found = steps(empty=empty, grid=voxels.grid(PAPER_GRID_MM))
    if empty is not None and empty.is_dir() and not found.empty_by_frame:
        mean = found.folder / EMPTY
        if not mean.is_file():
            room = Frames.open(empty)
            frames = (capture_of(room, number) for number in room.numbers or ())
            save(mean, average_frames(frames), found.origin, force=True)
        found = replace(found, empty=mean)
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
    """Say what is in the folder.

    Raises
    ------
    MeasurementError
        Some frames are not.
    """
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

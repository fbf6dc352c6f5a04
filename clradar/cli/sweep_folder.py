"""A sweep in a folder that keeps every image, so that one that is killed resumes there."""

from __future__ import annotations

import csv
import io
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from clradar.cli.console import print_line, print_text, progress_bar
from clradar.cli.resumable import SETTINGS, FolderStore, begin_work, clear
from clradar.compare import METRICS
from clradar.files import work_folder
from clradar.files.atomic import write_file
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from calibration import Sweep
    from clradar import Device, Scene, Volume

TRANSFORM, RESULT = "transform.json", "sweep.json"
TABLE, REGION_TABLE, FIGURE = "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

RESULTS = (FIGURE, TABLE, RESULT)
FILES = (SETTINGS, TRANSFORM, RESULT, TABLE, REGION_TABLE, FIGURE)

OWN_NAMES = (*FILES, WORK)
"""Names in the folder of a sweep that are its own; --force replaces no others. The settings first:
the rest of a removal that is cut short then belongs to no sweep."""

held = partial(work_folder.held, work="sweep")
"""Make the folder, and keep other sweeps out of it while the block runs."""

begin_sweep = partial(begin_work, own=OWN_NAMES, work="sweep")
"""Check that the content of the folder was made with some settings; see `begin_work`."""


Swept = TypeVar("Swept")


def sweep_into(
    folder: Path,
    measured: Volume | None,
    scene: Scene,
    run: Callable[..., Swept],
    write: Callable[[Path, Swept, Mapping[str, Any], str], None],
    *,
    source: str,
    origin: Mapping[str, Any],
    align: Mapping[str, Any] | None = None,
    device: Device,
    force: bool = False,
) -> Swept | None:
    """Sweep in a folder, or resume a sweep that was killed there.

    Parameters
    ----------
    folder : Path
        Made if missing; other processes are kept out of it meanwhile.
    measured : Volume or None
        Needed with `align`.
    scene : Scene
        In its place, or anywhere with `align`.
    run : callable
        Called with the scene, and the keywords `store` and `progress`; returns the result.
    write : callable
        Called with folder, result, `origin` and `source`; writes `RESULTS`, `RESULT` last, which
        marks the sweep as finished.
    source : str
        The name of the measurement, for the record.
    origin : mapping
        From `clradar.cli.provenance.provenance`; its options are the settings that a folder has to
        have been begun with.
    align : mapping, optional
        Find the pose of the mesh first, with these settings of `calibration.align_mesh`.
    device : Device
    force : bool
        Begin anew in a folder that was begun with other settings.

    Returns
    -------
    The result, or None if it was finished before.
    """
    with held(folder):
        begin_sweep(folder, {**origin["options"], "clradar": origin["clradar"]}, force=force)
        finished = is_finished(folder)
        if not finished:
            with _removed_if_nothing_is_done(folder):
                if align is not None:
                    assert measured is not None
                    place = _aligned(folder / TRANSFORM, measured, scene, device, origin, align)
                    scene = scene.transformed(place)
                store = FolderStore(folder / WORK)
                if len(store):
                    print_line(f"{folder}: resumes with {len(store)} images that are done")
                with progress_bar("sweeping") as progress:
                    result = run(scene, store=store, progress=progress)
                with progress_bar("drawing"):
                    write(folder, result, origin, source)
        shutil.rmtree(folder / WORK, ignore_errors=True)
    return None if finished else result


@contextmanager
def _removed_if_nothing_is_done(folder: Path) -> Iterator[None]:
    """Leave no settings of a sweep that fails before there is anything to resume with."""
    try:
        yield
    except Exception:  # an interruption is to be resumed
        done = [folder / TRANSFORM, *(folder / WORK).glob("*.npz")]
        if not any(path.is_file() for path in done):
            clear(folder, OWN_NAMES)
        raise


def _aligned(
    path: Path,
    measured: Volume,
    scene: Scene,
    device: Device,
    origin: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> np.ndarray:
    """The pose of the mesh: from the file of an earlier run, or found and written."""
    from calibration import align_mesh
    from measurement_io import read_transform

    if path.is_file():
        return read_transform(path)
    with progress_bar("aligning") as progress:
        found = align_mesh(measured, scene, device=device, progress=progress, **settings)
    write_json(path, {**found.to_dict(), **origin}, force=False)
    print_text(found.report())
    return found.transform


def write_results(folder: Path, result: Sweep, origin: Mapping[str, Any], source: str) -> None:
    """Write figure and tables of a sweep over alpha, and last the JSON file."""
    from calibration.roughness.figure import sweep_figure
    from clradar.plot import save_figure

    save_figure(sweep_figure(result), folder / FIGURE, force=True)
    write_csv(folder / TABLE, ("alpha", "seed", *METRICS, "score"), _rows(result))
    if result.regions is not None:
        names = ("region", "alpha", "seed", result.estimate.metric, "score")
        write_csv(folder / REGION_TABLE, names, _region_rows(result))
    write_json(folder / RESULT, {"measured": source, **result.to_dict(), **origin}, force=True)


def _rows(result: Sweep) -> Iterator[Sequence[Any]]:
    """One row per alpha and seed: the metrics, and the score."""
    for i, alpha in enumerate(result.alphas):
        for k, seed in enumerate(result.seeds):
            values = [getattr(result.metrics[k][i], name) for name in METRICS]
            yield float(alpha), seed, *values, float(result.estimate.score[k, i])


def _region_rows(result: Sweep) -> Iterator[Sequence[Any]]:
    """One row per region, alpha and seed, all other regions at their best alpha."""
    assert result.regions is not None
    for name, found in zip(result.regions.names, result.regions.estimates, strict=True):
        for i, alpha in enumerate(result.alphas):
            for k, seed in enumerate(result.seeds):
                yield name, float(alpha), seed, float(found.values[k, i]), float(found.score[k, i])


def write_csv(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write rows below their names."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    write_file(path, text.getvalue().encode(), force=True)


def is_finished(folder: Path) -> bool:
    """Whether all results are there; the last to be written is RESULT."""
    return all((folder / name).is_file() for name in RESULTS)

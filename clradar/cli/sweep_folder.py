"""A sweep in a folder that keeps every image, so that one that is killed resumes there."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from clradar.cli.console import print_line, print_text, progress_bar
from clradar.compare import METRICS
from clradar.errors import OutputError
from clradar.files import work_folder
from clradar.files.atomic import replacing, write_file
from clradar.files.failures import fail, reading
from clradar.files.json_differences import differences, listed_differences
from clradar.files.json_file import read_json, write_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.files.work_folder import LOCK, remove_temporaries

if TYPE_CHECKING:
    from calibration import Sweep
    from clradar import Device, Scene, Volume

SETTINGS, TRANSFORM, RESULT = "settings.json", "transform.json", "sweep.json"
TABLE, REGION_TABLE, FIGURE = "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

RESULTS = (FIGURE, TABLE, RESULT)
# The settings first: the rest of a removal that is cut short then belongs to no sweep.
FILES = (SETTINGS, TRANSFORM, RESULT, TABLE, REGION_TABLE, FIGURE)

OWN_NAMES = (*FILES, WORK)
"""Names in the folder of a sweep that are its own; --force replaces no others."""

held = partial(work_folder.held, work="sweep")
"""Make the folder, and keep other sweeps out of it while the block runs."""


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
            _clear(folder)
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


class FolderStore(MutableMapping[str, dict[str, np.ndarray]]):
    """Arrays by name, each name a file that is there whole or not at all."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(exist_ok=True)
        remove_temporaries(folder)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.npz"

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._path(name).is_file()

    def __getitem__(self, name: str) -> dict[str, np.ndarray]:
        if name not in self:
            raise KeyError(name)
        path = self._path(name)
        with reading(path, "the arrays of an image"), np.load(path, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files}

    def __setitem__(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        with replacing(self._path(name), force=True) as temporary, open(temporary, "xb") as file:
            values: dict[str, Any] = dict(arrays)
            np.savez(file, **values)

    def __delitem__(self, name: str) -> None:
        self._path(name).unlink()

    def __iter__(self) -> Iterator[str]:
        return (path.stem for path in sorted(self._folder.glob("*.npz")))

    def __len__(self) -> int:
        return sum(1 for _ in self)


def begin_sweep(folder: Path, settings: Mapping[str, Any], *, force: bool) -> None:
    """Check that the content of the folder was made with these settings.

    An empty folder takes them on. With `force` one that was begun with others is cleared: of the
    files of a sweep, and of nothing else.

    Raises
    ------
    OutputError
        It was begun with other settings, or holds files but no sweep.
    """
    remove_temporaries(folder)
    path = folder / SETTINGS
    if path.exists() or path.is_symlink():
        different = differences(_read_settings(path, force), _plain(settings))
        if not different:
            return
        if not force:
            raise OutputError(
                f"{folder}: was begun with other settings: {listed_differences(different)}. Repeat "
                "them to resume, choose another folder, or begin anew with --force"
            )
    elif not force and any(entry.name != LOCK for entry in folder.iterdir()):
        raise OutputError(
            f"{folder}: holds files, but no sweep; choose another folder, or write among them with "
            "--force"
        )
    _clear(folder)
    write_json(path, dict(settings), force=False)


def _clear(folder: Path) -> None:
    try:
        for name in FILES:
            (folder / name).unlink(missing_ok=True)
        if (folder / WORK).exists():
            shutil.rmtree(folder / WORK)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be cleared: {error}") from error


def _read_settings(path: Path, force: bool) -> dict[str, Any]:
    expected = "the settings of a sweep, as JSON"
    try:
        value = read_json(path, expected, MAX_SMALL_JSON_BYTES)
        if not isinstance(value, dict):
            fail(path, expected, "no JSON object")
        return value
    except ValueError:  # MeasurementError is one
        if force:
            return {}
        raise


def _plain(settings: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(settings, allow_nan=False))


def is_finished(folder: Path) -> bool:
    """Whether all results are there; the last to be written is RESULT."""
    return all((folder / name).is_file() for name in RESULTS)

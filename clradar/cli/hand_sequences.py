"""``clradar fit-hand --frames``: recordings of moving hands, one by one or on workers."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.console import print_warning, progress_bar
from clradar.cli.hand_sequence import HandSequence
from clradar.cli.movement_table import print_sequence
from clradar.cli.options.imaging import GridOptions, ImagingOptions
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.sequence import SequenceOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_place_of_folder
from clradar.errors import ClradarError, ClradarWarning, CompareError

if TYPE_CHECKING:
    from calibration.hand_fit.frame_fit import FrameFit
    from clradar.model.progress import Progress


def fit_sequences(
    chosen: SequenceOptions,
    sources: Sequence[Path],
    output: Path,
    frame: FrameOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    *,
    settings: Mapping[str, Any],
    origin: Mapping[str, Any],
    device: str | None,
    force: bool,
) -> list[Path]:
    """Fit recordings into `output`, of several each into a folder of its own there; return these.

    Raises
    ------
    CompareError
        Some of several failed; a warning says why of each.
    """
    from clradar.dataset.engine.worker_resources import divided
    from clradar.opencl.device import several

    if frame.frame is not None:
        raise wrong_usage("--frame", "expected without --frames")
    voxels.grid()  # wrong usage is reported before a file is read
    check_place_of_folder(output, inputs=sources)
    folders = [output]
    if len(sources) > 1:
        folders = [output / f"{i:03d}-{path.resolve().name}" for i, path in enumerate(sources)]
    workers, device = divided(chosen.workers, device)
    if len(sources) == 1 and several(device):
        raise wrong_usage("--device", "expected one: each frame is fitted from the one before")
    sequences = [
        HandSequence(source, folder, chosen, frame.variant, voxels, imaging, settings,
                     _with_frames(origin, source, chosen.frames), device, force)
        for source, folder in zip(sources, folders, strict=True)
    ]  # fmt: skip
    failed: list[Path] = []

    def done(sequence: HandSequence, outcome: list[FrameFit] | ClradarError) -> None:
        if not isinstance(outcome, ClradarError):
            print_sequence(sequence.folder, outcome)
            return
        if len(sequences) == 1:
            raise outcome
        print_warning(f"{sequence.source}: {outcome}")
        failed.append(sequence.source)

    fit = _one_by_one if workers is None else partial(_on_workers, workers)
    fit(sequences, done)
    if failed:
        raise CompareError(f"{len(failed)} of {len(sequences)} recordings could not be fitted")
    return folders


def _with_frames(origin: Mapping[str, Any], source: Path, frames: str | None) -> dict[str, Any]:
    options = {**origin["options"], "recording": str(source), "frames": frames}
    return {**origin, "options": options}


Done = Callable[[HandSequence, "list[FrameFit] | ClradarError"], None]


def _one_by_one(sequences: Sequence[HandSequence], done: Done) -> None:
    for sequence in sequences:
        with progress_bar(f"fitting {sequence.source.name}") as progress:
            outcome = _outcome(sequence, progress)
        done(sequence, outcome)


def _on_workers(workers: int, sequences: Sequence[HandSequence], done: Done) -> None:
    """The same on worker processes of this machine."""
    from distributed import as_completed

    from clradar.dataset.engine.cluster import DEVICE, local_cluster
    from clradar.dataset.engine.worker_resources import worker_resources

    resources = worker_resources(min(workers, len(sequences)), sequences[0].device)
    with (
        local_cluster(resources) as (client, end),
        client.as_current(),
        progress_bar("fitting") as progress,
    ):
        futures = {
            client.submit(
                # Each worker has its device in CLRADAR_DEVICE.
                _with_warnings, replace(sequence, device=None), resources={DEVICE: 1}, pure=False
            ): sequence
            for sequence in sequences
        }  # fmt: skip
        for number, future in enumerate(as_completed(futures), start=1):
            outcome, said = future.result()
            for text in said:
                print_warning(f"{futures[future].source}: {text}")
            done(futures[future], outcome)
            if progress is not None:
                progress(number, len(futures))
        end()


def _outcome(
    sequence: HandSequence, progress: Progress | None = None
) -> list[FrameFit] | ClradarError:
    """The fits of a recording, or why there are none: an error keeps its type on its way back."""
    try:
        return sequence.run(progress)
    except ClradarError as error:
        return error


def _with_warnings(sequence: HandSequence) -> tuple[list[FrameFit] | ClradarError, list[str]]:
    """The outcome on a worker, and what it warned of, each once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ClradarWarning)
        outcome = _outcome(sequence)
    ours = (str(one.message) for one in caught if issubclass(one.category, ClradarWarning))
    return outcome, list(dict.fromkeys(ours))

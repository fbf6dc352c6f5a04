"""``clradar fit-hand --frames``: recordings of moving hands, one by one or on workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.console import print_warning, progress_bar
from clradar.cli.hand_sequence import HandSequence
from clradar.cli.movement_table import print_sequence
from clradar.cli.on_workers import each_on_workers
from clradar.cli.options.imaging import GridOptions, ImagingOptions
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.sequence import SequenceOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_place_of_folder
from clradar.errors import ClradarError, CompareError

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
    from clradar.opencl.choice import several

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

    fit = _one_by_one if workers is None else partial(_on_workers, workers, device)
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


def _on_workers(
    workers: int, device: str | None, sequences: Sequence[HandSequence], done: Done
) -> None:
    """The same on worker processes of this machine."""
    with progress_bar("fitting") as progress:
        # Each worker has its device in CLRADAR_DEVICE.
        elsewhere = [replace(sequence, device=None) for sequence in sequences]
        outcomes = each_on_workers(HandSequence.run, elsewhere, workers, device)
        for number, (sequence, (outcome, said)) in enumerate(outcomes, start=1):
            for text in said:
                print_warning(f"{sequence.source}: {text}")
            done(sequence, outcome)
            if progress is not None:
                progress(number, len(sequences))


def _outcome(
    sequence: HandSequence, progress: Progress | None = None
) -> list[FrameFit] | ClradarError:
    try:
        return sequence.run(progress)
    except ClradarError as error:
        return error

"""Single samples: made again and compared with the stored one, or timed to estimate a data set."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from clradar.dataset.folder import read_manifest, refuse_own
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import Sample, make_sample
from clradar.dataset.shards import assemble, data_bytes, read_sample, write_sample
from clradar.files.json_differences import differences
from clradar.jobs.resources import made_with
from clradar.opencl import open_device


@dataclass(frozen=True, slots=True)
class Replay:
    """A sample that was made again.

    Attributes
    ----------
    sample : Sample
    stored_in : str or None
        The file with the stored one, relative to the data set; None if there is none.
    differences : tuple of str
        One line per array or key of the recipe that differs; empty if all bits are the same.
    made_otherwise : tuple of str
        Versions and devices that differ from those that made the stored one.
    """

    sample: Sample
    stored_in: str | None
    differences: tuple[str, ...]
    made_otherwise: tuple[str, ...]


def replay(
    folder: Path,
    index: int,
    *,
    device: str | None = None,
    output: Path | None = None,
    force: bool = False,
    rigs: Path | None = None,
) -> Replay:
    """Make sample `index` of a data set again, from its recipe.

    One that is not stored is made from the plan.

    Parameters
    ----------
    folder : Path
    index : int
    device : str or None
        See `clradar.open_device`.
    output : Path, optional
        File to write the sample to, as a shard of one sample; none of the data set's own.
    force : bool
        Replace an existing file.
    rigs : Path, optional
        The folder that the plan's names of rig files are relative to; by default the current
        folder, then the data set's.

    Raises
    ------
    ModelError
        The plan has no such sample, or the file of its rig is not that of the plan.
    MeasurementError
        The folder is no data set, or damaged.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import read_plan, replay, run
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> result = run(read_plan("plan.toml"), Path("letters"))
    >>> again = replay(Path("letters"), 1)
    >>> again.stored_in, again.differences
    ('shards/shard-00000.h5', ())
    """
    manifest = read_manifest(folder)
    if output is not None:
        refuse_own(folder, output)
    wanted, place = recipe(manifest.plan, index), manifest.place_of(index)
    then: dict[str, Any] = {}
    stored = Sample(wanted, {})
    if place is not None:
        stored, then = read_sample(folder / place, index, data_bytes(wanted))
    opened = open_device(device)
    now = made_with(opened)
    made = make_sample(stored.recipe, opened, rigs=(Path(), folder) if rigs is None else rigs)
    if output is not None:
        level = manifest.plan.output.compression
        write_sample(output, made, now, compression=level, force=force)
    if place is None:
        return Replay(made, None, (), ())
    return Replay(made, place, tuple(_different(stored, made)), tuple(differences(then, now)))


def _different(stored: Sample, made: Sample) -> list[str]:
    found = []
    for name in dict.fromkeys([*stored.arrays, *made.arrays]):
        one, other = stored.arrays.get(name), made.arrays.get(name)
        if one is None or other is None:
            found.append(f"{name}: {'not stored' if one is None else 'not made'}")
        elif (one.shape, one.dtype) != (other.shape, other.dtype):
            found.append(f"{name}: {one.dtype} {one.shape}, now {other.dtype} {other.shape}")
        elif one.tobytes() != other.tobytes():
            found.append(f"{name}: {_deviation(one, other)}")
    return found


def _deviation(one: np.ndarray, other: np.ndarray) -> str:
    changed = int(np.count_nonzero((one != other) & ~(np.isnan(one) & np.isnan(other))))
    with np.errstate(invalid="ignore"):
        error = np.nanmax(np.abs(other.astype(np.complex128) - one))
        peak = np.nanmax(np.abs(one))
    return f"{changed} of {one.size} numbers differ, by up to {error:.3g}; the peak is {peak:.3g}"


@dataclass(frozen=True, slots=True)
class Estimate:
    """Cost of one sample, and of all.

    The first sample of a process, with kernels built, takes `first_s`, a later one `sample_s`, with
    writing.
    """

    samples: int
    device: str
    first_s: float
    sample_s: float
    sample_bytes: int
    total_bytes: int

    @property
    def total_s(self) -> float:
        return self.first_s + (self.samples - 1) * self.sample_s

    def lines(self) -> list[str]:
        """Return it as text."""
        return [
            f"one sample: {self.sample_s:.2f} s, {_bytes_text(self.sample_bytes)} "
            f"(the first of a process {self.first_s:.2f} s) on {self.device}",
            f"all {self.samples} samples: {_time_text(self.total_s)} one after the other, "
            f"{_bytes_text(self.total_bytes)}",
        ]


def estimate(plan: Plan, *, device: str | None = None) -> Estimate:
    """Make shards of one and of two samples in a temporary folder, and extrapolate to all.

    The first sample builds kernels and fills caches, so the second one counts. The time of a sample
    depends on its pose: on the area of the hand, and on how much of it is visible to the antennas.
    """
    opened = open_device(device)
    times_s, sizes, level = [], [], plan.output.compression
    with tempfile.TemporaryDirectory(prefix="clradar-") as name:
        parts: list[Path] = []
        for sample in (0, min(1, plan.samples - 1)):
            begun_s = perf_counter()
            parts.append(Path(name) / f"part-{len(parts)}.h5")
            made = make_sample(recipe(plan, sample), opened, rigs=plan.folder)
            write_sample(parts[-1], made, made_with(opened), compression=level)
            whole = Path(name) / f"shard-{len(parts)}.h5"
            assemble(whole, parts, compression=level)
            times_s.append(perf_counter() - begun_s)
            sizes.append(whole.stat().st_size)
    sample_bytes = sizes[1] - sizes[0]
    total = plan.samples * sample_bytes + plan.n_shards * max(0, sizes[0] - sample_bytes)
    return Estimate(plan.samples, opened.info.label, times_s[0], times_s[1], sample_bytes, total)


def _time_text(seconds: float) -> str:
    for limit_s, text in (
        (120, f"{seconds:.0f} s"),
        (7200, f"{seconds / 60:.0f} min"),
        (48 * 3600, f"{seconds / 3600:.1f} h"),
    ):
        if seconds < limit_s:
            return text
    return f"{seconds / 86400:.1f} days"


def _bytes_text(count: float) -> str:
    if count < 1024:
        return f"{count:.0f} bytes"
    for unit in ("KiB", "MiB", "GiB"):
        count /= 1024
        if count < 1024:
            return f"{count:.1f} {unit}"
    return f"{count / 1024:.1f} TiB"

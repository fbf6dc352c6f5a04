"""Estimate of the time and the disk space of a plan, from one timed sample."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from clradar.dataset.engine.part_making import made_with
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import make_sample
from clradar.dataset.store.shard_writer import assemble, write_sample
from clradar.opencl import open_device


@dataclass(frozen=True, slots=True)
class Estimate:
    """Cost of one sample, and of all.

    The first sample of a process, with kernels built, takes `first_s`, a later one `sample_s`, with
    writing. A sample needs `sample_bytes` of a shard, which adds `shard_bytes` of its own; its part
    needs `part_bytes` until its shard is closed.
    """

    samples: int
    device: str
    first_s: float
    sample_s: float
    sample_bytes: int
    part_bytes: int
    shard_bytes: int
    shard_size: int

    @property
    def total_s(self) -> float:
        return self.first_s + (self.samples - 1) * self.sample_s

    @property
    def total_bytes(self) -> int:
        """Bytes of all shards."""
        shards = -(-self.samples // self.shard_size)
        return self.samples * self.sample_bytes + shards * self.shard_bytes

    @property
    def peak_bytes(self) -> int:
        """Bytes of all shards, and of the parts of one."""
        return self.total_bytes + min(self.shard_size, self.samples) * self.part_bytes

    def lines(self) -> list[str]:
        """Return it as text."""
        return [
            f"one sample: {self.sample_s:.2f} s, {_bytes_text(self.sample_bytes)} "
            f"(the first of a process {self.first_s:.2f} s) on {self.device}",
            f"all {self.samples} samples: {_time_text(self.total_s)} one after the other, "
            f"{_bytes_text(self.total_bytes)}, at most {_bytes_text(self.peak_bytes)} meanwhile",
        ]


def estimate(plan: Plan, *, device: str | None = None) -> Estimate:
    """Make two samples of a plan in a temporary folder and extrapolate to all.

    The first sample builds kernels and fills caches, so the second one counts. The time of a sample
    depends on its pose: on the area of the hand, and on how much of it is visible to the antennas.
    """
    opened = open_device(device)
    times_s, sizes = [], []
    level = plan.output.compression
    with tempfile.TemporaryDirectory(prefix="clradar-") as name:
        parts: list[Path] = []
        for sample in (0, min(1, plan.samples - 1)):
            start_s = perf_counter()
            part = Path(name) / f"{len(parts)}.h5"
            made = make_sample(recipe(plan, sample), opened, rigs=plan.folder)
            write_sample(part, made, made_with(opened), compression=level, force=True)
            times_s.append(perf_counter() - start_s)
            parts.append(part)
        for count in (1, 2):  # the difference of their sizes is that of a sample
            whole = Path(name) / f"shard-{count}.h5"
            start_s = perf_counter()
            assemble(whole, parts[:count], compression=level)
            assembled_s = perf_counter() - start_s
            sizes.append(whole.stat().st_size)
        part_bytes = parts[1].stat().st_size
    return Estimate(
        samples=plan.samples,
        device=opened.info.label,
        first_s=times_s[0],
        sample_s=times_s[1] + assembled_s / 2,
        sample_bytes=sizes[1] - sizes[0],
        part_bytes=part_bytes,
        shard_bytes=max(0, 2 * sizes[0] - sizes[1]),
        shard_size=plan.output.shard_size,
    )


def _time_text(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    if seconds < 48 * 3600:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 86400:.1f} days"


def _bytes_text(count: float) -> str:
    for unit in ("bytes", "KiB", "MiB", "GiB", "TiB"):
        if count < 1024 or unit == "TiB":
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.1f} {unit}"
        count /= 1024
    raise AssertionError("unreachable")

"""Statistics of a complete data set: JSON, and CSV.

Mean and variance are merged over blocks as in Chan, Golub and LeVeque, "Updating formulae and a
pairwise algorithm for computing sample variances", 1979.
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.store.folder import STATISTICS, TABLE, Manifest
from clradar.dataset.store.shard_reader import fields_of, opened_shard
from clradar.dataset.store.shard_schema import FIELDS, LABELS
from clradar.files.atomic import write_file
from clradar.files.json_file import write_json

IMPAIRMENTS = {"snr_db": "dB", "coupling_db": "dB", "iq_gain_db": "dB", "iq_phase_rad": "rad"}
"""Impairments that may be drawn for each sample, and their units."""

COLUMNS = ("count", "min", "mean", "std", "max")

BLOCK = 16
"""Samples in memory at a time."""


@dataclass(slots=True)
class Spread:
    """Running count, minimum, mean, standard deviation and maximum."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0
    least: float = float("inf")
    greatest: float = float("-inf")

    def add(self, values: np.ndarray) -> None:
        """Merge more numbers, without those that are not finite."""
        known = np.asarray(values, dtype=np.float64)
        known = known[np.isfinite(known)]
        if not known.size:
            return
        mean = float(known.mean())
        squares = float(np.square(known - mean).sum())
        total = self.count + known.size
        delta = mean - self.mean
        self.squares += squares + delta**2 * self.count * known.size / total
        self.mean += delta * known.size / total
        self.count = total
        self.least = min(self.least, float(known.min()))
        self.greatest = max(self.greatest, float(known.max()))

    def record(self) -> dict[str, Any]:
        """Return the numbers by `COLUMNS`, None where there are no values."""
        values: tuple[float | None, ...] = (None,) * 4
        if self.count:
            deviation = float(np.sqrt(self.squares / self.count))
            values = (self.least, self.mean, deviation, self.greatest)
        return dict(zip(COLUMNS, (self.count, *values), strict=True))


@dataclass(slots=True)
class Summary:
    """Statistics of a data set.

    Attributes
    ----------
    samples, set_aside : int
    counts : mapping of str to Counter
        Samples of each pose, hand and rig.
    spreads : mapping of str to Spread
        Of labels and of features of products, one number per sample.
    units : mapping of str to str
    silent : list of int
        Samples whose image or capture is zero everywhere.
    """

    samples: int = 0
    set_aside: int = 0
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    spreads: dict[str, Spread] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    silent: list[int] = field(default_factory=list)

    def add(self, name: str, unit: str | None, values: np.ndarray) -> None:
        self.spreads.setdefault(name, Spread()).add(values)
        self.units[name] = unit or ""

    def record(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "samples": self.samples,
            "set_aside": self.set_aside,
            "silent": self.silent,
            "counts": {name: dict(sorted(c.items())) for name, c in self.counts.items()},
            "quantities": {
                name: {"unit": self.units[name], **spread.record()}
                for name, spread in self.spreads.items()
            },
        }

    def table(self) -> str:
        """Return the quantities as CSV."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["quantity", "unit", *COLUMNS])
        for name, spread in self.spreads.items():
            record = spread.record()
            writer.writerow([name, self.units[name], *record.values()])
        return text.getvalue()


def summarize(folder: Path, manifest: Manifest) -> Summary:
    """Return the statistics of all stored samples, from every product except meshes."""
    summary = Summary(set_aside=len(manifest.aside))
    summary.counts = {name: Counter() for name in ("pose", "handedness", "rig")}
    for number in sorted(manifest.shards):
        entry = manifest.shards[number]
        if entry.file is not None:
            with opened_shard(folder / entry.file) as file:
                _add_shard(summary, file)
    if set(summary.counts["rig"]) == {""}:
        del summary.counts["rig"]
    return summary


def write_summary(folder: Path, manifest: Manifest) -> None:
    """Write the statistics into the data set's folder."""
    summary = summarize(folder, manifest)
    write_json(folder / STATISTICS, summary.record(), force=True)
    write_file(folder / TABLE, summary.table().encode("utf-8"), force=True)


def _add_shard(summary: Summary, file: Any) -> None:
    labels = file["entry/labels"]
    samples = labels["sample"][:]
    summary.samples += len(samples)
    for name, counter in summary.counts.items():
        counter.update(text.decode("utf-8") for text in labels[name][:])
    for name, unit, values in _label_numbers(labels, file["entry/axes"]):
        summary.add(name, unit, values)
    silent = np.zeros(len(samples), dtype=bool)
    for name in fields_of(file):
        spec = FIELDS[name]
        if spec.ragged or name == "joints":
            continue
        data = file[spec.place]
        for at in range(0, len(samples), BLOCK):
            block = data[at : at + BLOCK].reshape(len(samples[at : at + BLOCK]), -1)
            for what, unit, values in _product_numbers(name, block):
                summary.add(f"{name}: {what}", unit, values)
            if name != "depth_map":
                silent[at : at + BLOCK] |= ~block.any(axis=1)
    summary.silent += samples[silent].tolist()


def _label_numbers(labels: Any, axes: Any) -> Iterator[tuple[str, str | None, np.ndarray]]:
    for name, label in LABELS.items():
        if len(label.axes) == 1 and name in labels:
            columns = [text.decode("utf-8") for text in axes[label.axes[0]][:]]
            values = labels[name][:]
            for i, column in enumerate(columns):
                yield f"{name}: {column}", label.units, values[:, i]
    faults = [json.loads(text)["impairments"] for text in labels["recipe"][:]]
    for key, unit in IMPAIRMENTS.items():
        values = [fault[key] for fault in faults if fault is not None and fault[key] is not None]
        if values:
            yield f"impairments: {key}", unit, np.array(values)


def _product_numbers(name: str, block: np.ndarray) -> Iterator[tuple[str, str | None, np.ndarray]]:
    """Yield features of a product: one number for each sample of a block, shape (n, size)."""
    if name == "depth_map":
        known = np.isfinite(block)
        count = known.sum(axis=1)
        total = np.where(known, block, 0.0).sum(axis=1, dtype=np.float64)
        yield "share with a depth", None, count / block.shape[1]
        yield "mean depth", "m", np.where(count > 0, total / np.maximum(count, 1), np.nan)
        return
    amplitude = np.abs(block)
    yield "peak", None, amplitude.max(axis=1)
    yield "RMS", None, np.sqrt(np.square(amplitude, dtype=np.float64).mean(axis=1))

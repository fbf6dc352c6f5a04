"""What sums up a complete data set: statistics as JSON and CSV, and a contact sheet."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.dataset.folder import CONTACT_SHEET, STATISTICS, TABLE, Manifest, shard_name
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import metres, read_recipe
from clradar.dataset.sample import Sample
from clradar.dataset.shards import (
    FIELDS,
    LABELS,
    axes_of,
    fields_of,
    opened_shard,
    row_of,
    sample_of,
    samples_of,
    stored_recipe,
)
from clradar.files.atomic import write_file
from clradar.files.json_file import write_json
from clradar.hand import JOINT_NAMES
from clradar.plot import AMPLITUDE_BACKGROUND, png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMPAIRMENTS = {
    "snr_db": "dB", "coupling_db": "dB", "iq_gain_db": "dB", "iq_phase_deg": "deg"
}  # fmt: skip
"""Impairments that may be drawn for each sample, and their units."""

STATISTICS_OF: Mapping[str, Callable[[np.ndarray], Any]] = {
    "min": np.min, "mean": np.mean, "std": np.std, "max": np.max
}  # fmt: skip

BLOCK = 16
"""Samples in memory at a time."""

MOST_SAMPLES, COLUMNS = 64, 8
CELL_INCHES, TITLE_INCHES, MARGIN_INCHES = 1.15, 0.22, 0.12
TITLE_PT = 7.0
DPI = 150

DYNAMIC_RANGE_DB = 25.0
"""Of amplitudes; lower ones are black."""

FRAME_M = 0.15
"""Half the side of a cell without an image, about the centre of the hand."""

LINE_COLOUR = "#4cc9f0"
"""Of the joints: visible on every colour of the scale."""


def write_summaries(folder: Path, manifest: Manifest) -> None:
    """Write those that are missing."""
    if not all((folder / name).is_file() for name in (STATISTICS, TABLE)):
        record = statistics(folder, manifest)
        write_json(folder / STATISTICS, record, force=True)
        write_file(folder / TABLE, _table(record["quantities"]).encode("utf-8"), force=True)
    shown = _shown(manifest)
    if shown and not (folder / CONTACT_SHEET).is_file():
        samples = [_read(folder, manifest, sample) for sample in shown]
        write_file(folder / CONTACT_SHEET, png_bytes(contact_sheet(samples), dpi=DPI), force=True)


# Statistics


def statistics(folder: Path, manifest: Manifest) -> dict[str, Any]:
    """Return counts of poses, hands and rigs, and statistics of labels and of features of products.

    A feature is one number for each sample. "silent" are the samples whose image or capture is zero
    everywhere.
    """
    counts: dict[str, Counter[str]] = {name: Counter() for name in ("pose", "handedness", "rig")}
    features: dict[str, tuple[str, list[np.ndarray]]] = {}
    silent: list[int] = []
    for number in sorted(manifest.shards):
        with opened_shard(folder / shard_name(number)) as file:
            if not samples_of(file):
                continue
            for name, counter in counts.items():
                counter.update(t.decode("utf-8") for t in file[f"entry/labels/{name}"][:])
            samples = np.array(samples_of(file))
            zero = np.zeros(len(samples), dtype=bool)
            for name, unit, values in (
                *_of_labels(file, manifest.plan), *_of_products(file, zero)
            ):  # fmt: skip
                features.setdefault(name, (unit or "", []))[1].append(values)
            silent += samples[zero].tolist()
    if set(counts["rig"]) == {""}:
        del counts["rig"]
    return {
        "samples": len(manifest.stored),
        "set_aside": len(manifest.aside),
        "silent": silent,
        "counts": {name: dict(sorted(counter.items())) for name, counter in counts.items()},
        "quantities": {
            name: {"unit": unit, **_spread(np.concatenate(values))}
            for name, (unit, values) in features.items()
        },
    }


def _spread(values: np.ndarray) -> dict[str, Any]:
    """Count, minimum, mean, standard deviation and maximum of the numbers that are finite."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    found = {name: float(f(known)) if known.size else None for name, f in STATISTICS_OF.items()}
    return {"count": known.size, **found}


def _table(quantities: dict[str, dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["quantity", "unit", "count", *STATISTICS_OF])
    writer.writerows([name, *record.values()] for name, record in quantities.items())
    return text.getvalue()


def _of_labels(file: Any, plan: Plan) -> Iterator[tuple[str, str | None, np.ndarray]]:
    labels = file["entry/labels"]
    for name, label in LABELS.items():
        if len(label.axes) == 1 and name in labels:
            columns = [text.decode("utf-8") for text in file[f"entry/axes/{label.axes[0]}"][:]]
            values = labels[name][:]
            for i, column in enumerate(columns):
                yield f"{name}: {column}", label.units, values[:, i]
    faults = [stored_recipe(text, plan)["impairments"] for text in labels["recipe"][:]]
    for key, unit in IMPAIRMENTS.items():
        values = [fault[key] for fault in faults if key in fault]
        if any(values):
            yield f"impairments: {key}", unit, np.array(values)


def _of_products(file: Any, silent: np.ndarray) -> Iterator[tuple[str, str | None, np.ndarray]]:
    """Features of products; marks the samples whose image or capture is zero everywhere."""
    for name in fields_of(file):
        data = file[FIELDS[name].place]
        if FIELDS[name].ragged or name == "joints":
            continue
        for at in range(0, len(data), BLOCK):
            block = data[at : at + BLOCK]
            block = block.reshape(len(block), -1)
            if name == "depth_map":
                known = np.isfinite(block)
                count = known.sum(axis=1)
                total = np.where(known, block, 0.0).sum(axis=1, dtype=np.float64)
                mean_m = np.where(count > 0, total / np.maximum(count, 1), np.nan)
                yield f"{name}: share with a depth", None, count / block.shape[1]
                yield f"{name}: mean depth", "m", mean_m
            else:
                amplitude = np.abs(block)
                power = np.square(amplitude, dtype=np.float64).mean(axis=1)
                yield f"{name}: peak", None, amplitude.max(axis=1)
                yield f"{name}: RMS", None, np.sqrt(power)
                silent[at : at + BLOCK] |= ~block.any(axis=1)


# Contact sheet


def _shown(manifest: Manifest) -> list[int]:
    """The samples of the contact sheet, spread evenly over the stored ones."""
    stored = manifest.stored
    # Rounded, so that the step does not beat with the cycle of poses.
    positions = np.linspace(0, len(stored) - 1, min(MOST_SAMPLES, len(stored))).tolist()
    return [stored[round(position)] for position in positions]


def _read(folder: Path, manifest: Manifest, sample: int) -> Sample:
    path = folder / str(manifest.place_of(sample))
    with opened_shard(path) as file:
        return sample_of(file, row_of(file, path, sample), manifest.plan)[0]


def contact_sheet(samples: list[Sample]) -> Figure:
    """Draw samples side by side: image, joints, pose and number.

    Parameters
    ----------
    samples : list of Sample
        Each is shown by its first product of: maximum projection, volume, depth map, mesh, capture.

    Returns
    -------
    matplotlib.figure.Figure
        Amplitudes in decibels below each image's maximum; x to the left, as seen from the radar.
    """
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(samples))
    rows = -(-len(samples) // columns)
    width = columns * CELL_INCHES + 2 * MARGIN_INCHES
    height = rows * (CELL_INCHES + TITLE_INCHES) + 2 * MARGIN_INCHES
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    inner = 0.94 * CELL_INCHES
    for i, sample in enumerate(samples):
        row, column = divmod(i, columns)
        left = MARGIN_INCHES + column * CELL_INCHES
        bottom = height - MARGIN_INCHES - (row + 1) * (CELL_INCHES + TITLE_INCHES)
        place = (left / width, bottom / height, inner / width, inner / height)
        axes = figure.add_axes(place)
        drawn = read_recipe(sample.recipe)
        _draw(axes, drawn.plan, sample.arrays)
        text = f"{drawn.sample}: {drawn.pose.name}"
        side = "" if drawn.plan.hands.handedness == "right" else ", left"
        axes.set_title(_short(text) + side, fontsize=TITLE_PT, pad=2, parse_math=False)
    return figure


def _short(text: str) -> str:
    return text if len(text) <= 20 else text[:19] + "…"


def _draw(axes: Any, plan: Plan, arrays: Mapping[str, np.ndarray]) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor(AMPLITUDE_BACKGROUND)
    rendering = _rendering(plan, arrays)
    if rendering is not None:
        image, (x_m, y_m), limits = rendering
        half = [0.5 * (a[1] - a[0]) if len(a) > 1 else 0.5e-3 for a in (x_m, y_m)]
        extent = (x_m[0] - half[0], x_m[-1] + half[0], y_m[0] - half[1], y_m[-1] + half[1])
        axes.imshow(
            image, extent=extent, origin="lower", cmap="magma", vmin=limits[0], vmax=limits[1],
            interpolation="nearest", aspect="equal",
        )  # fmt: skip
        axes.set_xlim(extent[1], extent[0])
        axes.set_ylim(extent[2], extent[3])
        if not plan.keeps_images:  # the axes are Tx and Rx
            return
    else:
        x_m, y_m, _ = metres(plan.placement)
        axes.set_xlim(x_m + FRAME_M, x_m - FRAME_M)
        axes.set_ylim(y_m - FRAME_M, y_m + FRAME_M)
        axes.set_aspect("equal")
        if "mesh_vertices" in arrays:
            points = arrays["mesh_vertices"]
            axes.plot(points[:, 0], points[:, 1], ",", color="#bbbbbb")
    if "joints" in arrays:
        _draw_joints(axes, arrays["joints"])


def _draw_joints(axes: Any, joints_m: np.ndarray) -> None:
    starts = [i for i, name in enumerate(JOINT_NAMES) if name.endswith("metacarpal")]
    for first, end in zip(starts, [*starts[1:], len(JOINT_NAMES)], strict=True):
        chain = joints_m[[0, *range(first, end)]]
        chain = chain[np.isfinite(chain).all(axis=1)]
        axes.plot(chain[:, 0], chain[:, 1], color=LINE_COLOUR, linewidth=0.4, alpha=0.8)


def _rendering(
    plan: Plan, arrays: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, tuple[Any, Any], tuple[float, float]] | None:
    """Return an image, its axes and the limits of its colours."""
    axes = axes_of(plan)
    if "max_projection" in arrays or "volume" in arrays:
        amplitude = arrays.get("max_projection")
        if amplitude is None:
            amplitude = np.abs(arrays["volume"]).max(axis=0)
        plane = (axes["x_m"][0], axes["y_m"][0])
        return _decibels(amplitude), plane, (-DYNAMIC_RANGE_DB, 0.0)
    if "depth_map" in arrays:
        depth_m = arrays["depth_map"]
        known = depth_m[np.isfinite(depth_m)]
        limits = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        return depth_m, (axes["x_m"][0], axes["y_m"][0]), limits
    if "capture" in arrays and "mesh_vertices" not in arrays:
        amplitude = np.abs(arrays["capture"]).mean(axis=2)
        plane = (np.arange(amplitude.shape[1]), np.arange(amplitude.shape[0]))
        return _decibels(amplitude), plane, (-DYNAMIC_RANGE_DB, 0.0)
    return None


def _decibels(amplitude: np.ndarray) -> np.ndarray:
    peak = float(amplitude.max())
    if peak == 0.0:
        return np.full(amplitude.shape, -np.inf)
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(amplitude / peak)

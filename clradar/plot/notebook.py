"""Records in notebooks: the figure of each kind beside its facts, without a script."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from contextlib import suppress
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clradar.compare.metrics import METRIC_TABLE, Metrics
from clradar.errors import CompareError
from clradar.model import AntennaArray, Capture, DepthMap, Scene, Volume, VoxelGrid, Waveform
from clradar.model.length_unit import unit_for
from clradar.plot.array import draw_elements
from clradar.plot.captures import capture_figure
from clradar.plot.drawing import SINGLE_PANEL_WIDTH, new_figure
from clradar.plot.images import image_figure
from clradar.plot.saving import figure_bytes

PICTURE_DPI = 110

MOST_LETTERS = 80  # of a line of the provenance


def html_of(record: Any) -> str | None:
    """Return figure and facts of a record, with all text escaped; None of a kind without them."""
    if type(record) not in KINDS:
        return None
    facts, figure = KINDS[type(record)]
    rows = "".join(
        f"<tr><th style='text-align:left; white-space:nowrap'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in facts(record).items()
    )
    picture = ""
    with suppress(CompareError):  # nothing to draw, such as zeros
        if figure is not None:
            content = base64.b64encode(figure_bytes(figure(record), dpi=PICTURE_DPI))
            picture = f"<img alt='' src='data:image/png;base64,{content.decode()}'>"
    return f"<div><strong>{type(record).__name__}</strong><table>{rows}</table>{picture}</div>"


def _axes_facts(image: VoxelGrid | DepthMap, names: str = "xyz") -> dict[str, str]:
    axes_m = {name: getattr(image, f"{name}_m") for name in names}
    unit = unit_for(*(float(axis_m[i]) for axis_m in axes_m.values() for i in (0, -1)))
    return {
        name: f"{unit.per_m * axis_m[0]:.6g} to {unit.per_m * axis_m[-1]:.6g} {unit.name}, "
        f"{len(axis_m)} values"
        for name, axis_m in axes_m.items()
    }


def _meta_facts(meta: Mapping[str, Any]) -> dict[str, str]:
    """What was said of a record in a word or number; `clradar inspect` has the tables, too."""
    short = {key: str(value) for key, value in meta.items() if isinstance(value, str | int | float)}
    return {key: text for key, text in short.items() if len(text) <= MOST_LETTERS}


def _volume_facts(volume: Volume) -> dict[str, str]:
    k, j, i = np.unravel_index(int(np.abs(volume.data).argmax()), volume.data.shape)
    grid, unit = volume.grid, unit_for(*volume.grid.z_m)
    place = (f"{unit.per_m * at:.4g}" for at in (grid.x_m[i], grid.y_m[j], grid.z_m[k]))
    strongest = f"{abs(volume.data[k, j, i]):.3g} at {', '.join(place)} {unit.name}"
    return {**_axes_facts(grid), "strongest voxel": strongest, **_meta_facts(volume.meta)}


def _depth_facts(image: DepthMap) -> dict[str, str]:
    count = f"{image.mask.sum()} of {image.mask.size}, down to {-image.dynamic_range_db:g} dB"
    return {**_axes_facts(image, "xy"), "pixels with a depth": count}


def _waveform_facts(waveform: Waveform) -> dict[str, str]:
    first, last = waveform.frequencies_hz[[0, -1]] / 1e9
    farthest_m = waveform.unambiguous_range_m
    unit = unit_for(farthest_m)
    return {
        "frequencies": f"{first:g} to {last:g} GHz, {waveform.n_freq}",
        "range resolution": f"{1e3 * waveform.range_resolution_m:.3g} mm",
        "unambiguous range": f"{unit.per_m * farthest_m:.4g} {unit.name}",
    }


def _array_facts(array: AntennaArray) -> dict[str, str]:
    width, height = 1e3 * np.ptp(np.concatenate([array.tx_m, array.rx_m])[:, :2], axis=0)
    text = f"{array.name}: {array.n_tx} Tx, {array.n_rx} Rx within {width:.4g} mm x {height:.4g} mm"
    return {"array": text}


def _capture_facts(capture: Capture) -> dict[str, str]:
    strongest = {"strongest sample": f"{np.abs(capture.data).max():.3g}"}
    radar = {**_array_facts(capture.array), **_waveform_facts(capture.waveform)}
    return {**radar, **strongest, **_meta_facts(capture.meta)}


def _scene_facts(scene: Scene) -> dict[str, str]:
    low, high = scene.vertices_m.min(axis=0), scene.vertices_m.max(axis=0)
    unit = unit_for(*low, *high)
    ends = [f"{unit.per_m * a:.4g} to {unit.per_m * b:.4g}" for a, b in zip(low, high, strict=True)]
    return {
        "faces": str(scene.n_faces),
        "parts": ", ".join(scene.part_names),
        "materials": ", ".join(one.name for one in scene.materials),
        "alpha": " to ".join(dict.fromkeys(f"{end(scene.alpha):g}" for end in (np.min, np.max))),
        f"x, y, z ({unit.name})": ", ".join(ends),
    }


def _metrics_facts(metrics: Metrics) -> dict[str, str]:
    texts = {one.name: one.text(metrics) for one in METRIC_TABLE}
    return {**texts, "remarks": "; ".join(metrics.remarks) or "none"}


def _array_figure(array: AntennaArray) -> Figure:
    figure = new_figure(SINGLE_PANEL_WIDTH + 1.0, SINGLE_PANEL_WIDTH + 1.0)
    draw_elements(figure.subplots(), array)
    return figure


KINDS: Mapping[type, tuple[Callable[[Any], dict[str, str]], Callable[[Any], Figure] | None]] = {
    AntennaArray: (_array_facts, _array_figure),
    Capture: (_capture_facts, capture_figure),
    DepthMap: (_depth_facts, image_figure),
    Metrics: (_metrics_facts, None),
    Scene: (_scene_facts, None),
    Volume: (_volume_facts, image_figure),
    VoxelGrid: (_axes_facts, None),
    Waveform: (_waveform_facts, None),
}
"""What the table of a record says, and what draws it."""

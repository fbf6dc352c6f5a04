"""Tables of the report, metrics and the settings of every input; and text that is safe in it."""

from __future__ import annotations

import html
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from clradar.compare.metrics import METRIC_TABLE, Metric, Metrics
from clradar.errors import quoted
from clradar.model import DepthMap, Volume
from clradar.model.length_unit import METRES, unit_for
from clradar.plot.drawing import typeset

MAX_ROWS = 200  # rows of one record of settings; the page states how many are omitted
MAX_NAME, MAX_VALUE = 120, 400  # characters of one row
MEANINGS = {
    "overlap": (
        "Agreement in position and brightness: cosine between the two depth maps, each point "
        "blurred by 2 mm and weighted with its amplitude; 1 is best. A simulated hand against "
        "itself has 0.996 with another seed, 0.83 if it is 2 mm too far away, 0.71 if it is 5 "
        "mm off to the side; two different poses have less than 0.1."
    ),
    "db_correlation": (
        "Agreement of bright and dark regions: Pearson correlation of the two images in decibel"
        " over all pixels, from \N{MINUS SIGN}1 to 1; 1 is best."
    ),
    "ssim": (
        "Agreement of level, contrast and pattern in small neighbourhoods: mean structural "
        "similarity of the two images in decibel; 1 is best."
    ),
    "mask_iou": (
        "Agreement of the masks: pixels that both show over pixels that either shows, from 0 to"
        " 1; 1 is best."
    ),
    "depth_rmse_m": (
        "Root mean square difference in millimetres of the depths where both have one; 0 is "
        "best. Read it with the mask IoU: pixels that only one shows do not count."
    ),
    "chamfer_simulated_to_measured_m": (
        "Surplus of the simulation: mean distance in millimetres from a simulated depth point "
        "to the nearest measured one; 0 is best."
    ),
    "chamfer_measured_to_simulated_m": (
        "Omission of the simulation: mean distance in millimetres from a measured depth point "
        "to the nearest simulated one; 0 is best."
    ),
}
"""Of the metrics, by their fields."""


def escaped(value: object) -> str:
    """Return `value` as HTML text that is also safe inside a quoted attribute.

    Unprintable characters are written as escapes, so that no name imitates another one.
    """
    return html.escape(quoted(value, sys.maxsize), quote=True)


def script_json(value: Any) -> str:
    """Return `value` as JSON for a <script> block: ASCII, without a character that could end it."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def shortened(value: object, longest: int) -> str:
    """Return `value` as text of at most `longest` characters, with a note of the missing number."""
    text = str(value)
    if len(text) <= longest:
        return text
    return f"{text[:longest]} … ({len(text) - longest} more characters)"


def metrics_section(labels: Sequence[str], metrics: Sequence[Metrics]) -> str:
    """Return table, remarks and meanings of the metrics of some simulated images.

    One row per image; of several the best value of a column is bold. On a narrow screen each row
    becomes a block with `data-name` before each value.
    """
    head = "".join(f'<th scope="col">{escaped(one.name)}</th>' for one in METRIC_TABLE)
    best = [_best(one, metrics) for one in METRIC_TABLE]
    rows, remarks = [], []
    for label, found in zip(labels, metrics, strict=True):
        cells = [f'<th scope="row">{escaped(label)}</th>']
        for one, best_text in zip(METRIC_TABLE, best, strict=True):
            shown = typeset(one.text(found))
            inner = f"<strong>{shown}</strong>" if shown == best_text else shown
            cells.append(f'<td data-name="{escaped(one.name)}">{inner}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
        name = f'<span class="name">{escaped(label)}</span>'
        remarks += [f"<li>{name}: {escaped(remark)}.</li>" for remark in found.remarks]
    meanings = []
    for one in METRIC_TABLE:
        undefined = any(math.isnan(getattr(found, one.field)) for found in metrics)
        why = f" n/a here: {escaped(one.undefined)}." if undefined else ""
        meanings.append(f"<dt>{escaped(one.name)}</dt><dd>{escaped(MEANINGS[one.field])}{why}</dd>")
    return (
        '<section><h2>Metrics</h2><table class="metrics"><thead><tr>'
        f'<th scope="col">Simulated</th>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
        + (f'<ul class="remarks">{"".join(remarks)}</ul>' if remarks else "")
        + f'<p class="hint">Both images cut {metrics[0].dynamic_range_db:g}&nbsp;dB below their '
        'maximum; bold is the best of several.</p><dl class="meanings">'
        f"{''.join(meanings)}</dl></section>"
    )


def _best(one: Metric, metrics: Sequence[Metrics]) -> str | None:
    """Return the best value as it is displayed, None for fewer than two values."""
    known = [found for found in metrics if not math.isnan(getattr(found, one.field))]
    if len(known) < 2:
        return None
    choose = max if one.higher_is_better else min
    return typeset(one.text(choose(known, key=lambda found: getattr(found, one.field))))


def image_facts(
    image: Volume | DepthMap, shown: DepthMap, source: str, *, dbsm: bool = False
) -> dict[str, str]:
    """Return the geometry and level of an image."""
    facts = {"file": source} if source else {}
    axes = [("x", shown.x_m), ("y", shown.y_m)]
    if isinstance(image, Volume):
        axes.append(("z", image.grid.z_m))
    unit = unit_for(*(float(axis_m[i]) for _, axis_m in axes for i in (0, -1)))
    digits = 4 if unit is METRES else 1
    for name, axis_m in axes:
        first, last = unit.per_m * axis_m[[0, -1]]
        ends = f"{first:.6g} to {last:.6g} {unit.name} in {len(axis_m)}"
        step = unit.per_m * np.diff(axis_m).mean() if len(axis_m) > 1 else None
        facts[name] = ends + (f", every {step:.4g} {unit.name}" if step is not None else "")
    depths = unit.per_m * shown.depth_m[shown.mask]
    facts["depth points"] = (
        f"{len(depths)} within {shown.dynamic_range_db:g} dB of the maximum, "
        f"{depths.min():.{digits}f} to {depths.max():.{digits}f} {unit.name} deep"
    )
    row, column = divmod(int(np.argmax(shown.amplitude)), len(shown.x_m))
    place_m = {"x": shown.x_m[column], "y": shown.y_m[row], "z": shown.depth_m[row, column]}
    where = ", ".join(
        f"{name} = {np.round(unit.per_m * value, digits) + 0.0:.{digits}f}"  # no minus before 0
        for name, value in place_m.items()
        if np.isfinite(value)
    )
    if dbsm:
        top_dbsm = 20 * math.log10(shown.amplitude.max())
        facts["highest radar cross section"] = f"{top_dbsm:.1f} dBsm, at {where} {unit.name}"
    else:
        facts["maximum of the amplitude"] = f"{shown.amplitude.max():.4g}, at {where} {unit.name}"
    return facts


def settings_table(record: Mapping[str, Any]) -> str:
    """Return a record as rows of dotted names and values, limited in rows and characters."""
    found = list(_flat(record, ""))
    rows = "".join(
        f'<tr><th scope="row">{escaped(shortened(name, MAX_NAME))}</th>'
        f"<td>{escaped(shortened(value, MAX_VALUE))}</td></tr>"
        for name, value in found[:MAX_ROWS]
    )
    table = f'<table class="settings"><tbody>{rows}</tbody></table>'
    if (left_out := len(found) - MAX_ROWS) > 0:
        table += f"<p>{left_out} more rows are omitted here; the file has them.</p>"
    return table


def _flat(value: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield (dotted name, text) for every value in nested mappings and lists."""
    inner = isinstance(value, Mapping) or (
        isinstance(value, list | tuple) and any(isinstance(v, Mapping | list) for v in value)
    )
    if not inner:
        yield name, _setting_text(value)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else str(key))
    else:
        for i, item in enumerate(value):
            yield from _flat(item, f"{name}[{i}]")


def _setting_text(value: Any) -> str:
    if value is None:
        return "\N{EN DASH}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(map(_setting_text, value)) or "none"
    return str(value)

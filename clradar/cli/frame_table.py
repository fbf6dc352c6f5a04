"""Table and curves over time of the frames that ``clradar process`` did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clradar.cli.comparison import METRIC_COLUMNS
from clradar.cli.movement_table import hand_columns
from clradar.cli.sweep_folder import write_csv

Record = Mapping[str, Any]

LEVELS = {"peak dB": "peak_db", "recorded RMS dB": "recorded_db", "cleaned RMS dB": "cleaned_db"}


def table(records: Sequence[Record], labels: Sequence[str]) -> dict[str, np.ndarray]:
    """The columns of the table by name, each of shape (n,), float64; NaN where there is none.

    Parameters
    ----------
    records : sequence of mapping
        Of the frames, from `clradar.cli.frame_steps.FrameSteps.run`.
    labels : sequence of str
        Of the simulations.
    """
    stamps = _column(records, lambda one: one["time_us"])
    start = stamps[np.isfinite(stamps)][:1]
    found = {
        "frame": _column(records, lambda one: one["frame"]),
        "time s": (stamps - start) / 1e6 if start.size else stamps,
    }
    found |= {name: _column(records, lambda one, key=key: one[key]) for name, key in LEVELS.items()}
    for what in ("peak", "centre"):
        for i, axis in enumerate("xyz"):
            found[f"{what} {axis} mm"] = _column(
                records,
                lambda one, key=f"{what}_m", i=i: 1e3 * one[key][i],
            )
    for i, label in enumerate(labels):
        for name, (key, scale, _) in METRIC_COLUMNS.items():
            found[f"{label}: {name}" if len(labels) > 1 else name] = _column(
                records,
                lambda one, i=i, key=key, scale=scale: scale * one["metrics"][i][key],
            )
    if any("alignment" in one for one in records):
        found |= _motion(records)
    if any("hand" in one for one in records):
        from calibration.hand_fit.frame_fit import FrameFit

        fits = (one.get("hand") for one in records)
        found |= hand_columns([fit and FrameFit.from_dict(fit, Path("hand")) for fit in fits])
    return found


def _column(records: Sequence[Record], value: Any) -> np.ndarray:
    values = []
    for one in records:
        try:
            found = value(one)
        except (KeyError, TypeError):  # a frame without an image, or that could not be aligned
            found = None
        values.append(np.nan if found is None else float(found))
    return np.array(values)


def _motion(records: Sequence[Record]) -> dict[str, np.ndarray]:
    """Rotation and translation of the aligned mesh, about its centre in the first frame."""
    from scipy.spatial.transform import Rotation

    rows = np.full((len(records), 8), np.nan)
    about: np.ndarray | None = None
    for row, one in zip(rows, records, strict=True):
        if "transform" not in one.get("alignment", {}):
            continue
        matrix = np.asarray(one["alignment"]["transform"], np.float64)
        if about is None:
            centre_m = np.asarray(one["alignment"]["centre_m"], np.float64)
            about = matrix[:3, :3].T @ (centre_m - matrix[:3, 3])
            first = matrix
        row[:3] = 1e3 * (matrix[:3, :3] @ about + matrix[:3, 3])
        row[3:6] = np.degrees(Rotation.from_matrix(matrix[:3, :3] @ first[:3, :3].T).as_rotvec())
        row[6:] = one["alignment"]["inlier_share"], 1e3 * one["alignment"]["rms_m"]
    names = [f"mesh {axis} mm" for axis in "xyz"] + [f"mesh turn {axis} deg" for axis in "xyz"]
    return dict(zip([*names, "mesh inliers", "mesh rms mm"], rows.T, strict=True))


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write one row per frame; cells without a value are empty."""
    rows = zip(*(map(_cell, values) for values in columns.values()), strict=True)
    write_csv(path, list(columns), rows)


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.10g}"


def curves(columns: Mapping[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """What is drawn over time: axis name -> curve -> values; without what has no value."""
    panels = {
        "level (dB)": list(LEVELS),
        "centre (mm)": [f"centre {axis} mm" for axis in "xyz"],
        "mesh (mm)": [f"mesh {axis} mm" for axis in "xyz"],
        "mesh turned (deg)": [f"mesh turn {axis} deg" for axis in "xyz"],
    }
    for metric in ("overlap", "depth RMSE (mm)"):
        panels[metric] = [name for name in columns if name.endswith(metric)]
    drawn: dict[str, dict[str, np.ndarray]] = {}
    for panel, names in panels.items():
        there = {n: columns[n] for n in names if n in columns and np.isfinite(columns[n]).any()}
        if panel in ("level (dB)", "centre (mm)", "mesh (mm)"):
            # About their mean, since 300 mm of depth would flatten everything else.
            there = {
                f"{n.rsplit(' ', 1)[0]} {np.nanmean(v):+.1f}": v - np.nanmean(v)
                for n, v in there.items()
            }
        if there:
            drawn[panel] = there
    return drawn

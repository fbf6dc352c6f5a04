"""Tables of `hand_fit.py`: errors of fitted hands by row of cases, each figure with its count.

A record of a case has what `Case` tells of it, and under the name of an estimator its errors,
`tips_mm` and `joints_mm`, and what else `hand_fit.record_of` takes from a fit; or a `failure`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

Record = dict[str, Any]

MISSED_MM, MISSED_DEVIANCE = 6.0, 2.0
"""The search missed if the fit from the truth has a deviance that is smaller by more than drawing
surfaces anew changes it, and a tip elsewhere by more than this."""

LIMIT_DRAWS = 2000
"""Errors that are drawn of every covariance."""

TURNED_LETTERS = "GHPQ"
"""The hand points to the side or at the radar, which sees its edge."""

OTHERS = {
    "rigid": "rigid only",
    "mean": "prior's mean, at the true palm",
    "fit": "fit",
    "truth": "fit that starts at the truth",
}

LIMIT = "what the truth's information allows"
"""Errors that information and prior at the true pose predict: of a fit that neither misses nor has
any bias. What nothing shows errs there as the prior does."""


def _letter(record: Record) -> bool:
    return record["kind"] != "null" and record["letter"] is not None


def _bright(record: Record) -> bool:
    return record["lowest_alpha"] is not None and record["lowest_alpha"] >= 0.3


ROWS: dict[str, Callable[[Record], bool]] = {
    "letter, alpha >= 0.3": lambda r: _letter(r) and _bright(r),
    "  parametric truth": lambda r: _letter(r) and _bright(r) and r["kind"] == "alpha",
    "  truth from a rig": lambda r: _letter(r) and _bright(r) and r["kind"] == "rig",
    "  without G, H, P, Q": lambda r: (
        _letter(r) and _bright(r) and r["letter"] not in TURNED_LETTERS
    ),
    "letter, 0.1 < alpha < 0.3": lambda r: (
        _letter(r) and r["lowest_alpha"] is not None and 0.1 < r["lowest_alpha"] < 0.3
    ),
    "letter, alpha <= 0.1": lambda r: (
        _letter(r) and r["lowest_alpha"] is not None and r["lowest_alpha"] <= 0.1
    ),
    "physical, letter": lambda r: _letter(r) and r["kind"] == "physical",
    "free": lambda r: r["kind"] != "null" and r["letter"] is None,
    "null test": lambda r: r["kind"] == "null",
    "all": lambda r: True,
}


def values(records: Sequence[Record], estimator: str, key: str) -> np.ndarray:
    """Numbers of all records in which the estimator found something, one after the other."""
    found = [
        np.array(r[estimator][key], float).ravel()
        for r in records
        if key in r.get(estimator, {}) and r[estimator][key] is not None
    ]
    joined = np.concatenate(found) if found else np.empty(0)
    return joined[np.isfinite(joined)]


def median_and_95(errors: np.ndarray) -> str:
    """Median and 95 % of errors, (n,) or of n tips (n, draws), with the count n."""
    if not len(errors):
        return f"{'-':>17s}"
    middle, high = np.median(errors), np.quantile(errors, 0.95)
    return f"{middle:5.1f}{high:6.1f} ({len(errors):3d})"


def allowed(covariances: np.ndarray) -> np.ndarray:
    """Lengths, (n, LIMIT_DRAWS), of normal errors that are drawn of covariances, (n, 3, 3)."""
    variances, axes = np.linalg.eigh(covariances)
    along = axes * np.sqrt(np.maximum(variances, 0.0))[:, None]
    normal = np.random.default_rng(0).standard_normal((len(covariances), 3, LIMIT_DRAWS))
    lengths: np.ndarray = np.linalg.norm(along @ normal, axis=1)
    return lengths


def missed(record: Record) -> bool | None:
    """Whether the search missed what the fit from the truth found; None where either failed."""
    fit, truth = record.get("fit", {}), record.get("truth", {})
    if "deviance" not in fit or "deviance" not in truth:
        return None
    apart_mm = np.linalg.norm(np.subtract(fit["at_mm"], truth["at_mm"]), axis=1)
    better = fit["deviance"] - truth["deviance"] > MISSED_DEVIANCE
    return bool(better and np.nanmax(apart_mm) > MISSED_MM)


def fit_line(label: str, records: Sequence[Record]) -> str:
    tips, std, told = (values(records, "fit", key) for key in ("tips_mm", "tip_std_mm", "told"))
    told = told.astype(bool)
    joints = values(records, "fit", "joints_mm")
    overlap, time_s = (values(records, "fit", key) for key in ("overlap", "time_s"))
    failed = sum("failure" in r["fit"] for r in records if "fit" in r)
    cells = [
        f"{label:26s}{len(records):3d}{failed:4d}",
        median_and_95(tips),
        median_and_95(tips[told]) + (f"{np.mean(told):5.0%}" if len(told) else f"{'-':>5s}"),
        f"{np.median(joints):5.1f}" if len(joints) else f"{'-':>5s}",
        f"{np.median(overlap):5.3f} ({len(overlap):2d})" if len(overlap) else f"{'-':>10s}",
        f"{np.median(time_s):4.0f}{time_s.max():5.0f}" if len(time_s) else f"{'-':>9s}",
        _share(tips <= 2 * std),
        _share(tips[told] <= 2 * std[told]),
    ]
    return " | ".join(cells)


def _share(within: np.ndarray) -> str:
    return f"{np.mean(within):4.0%} ({len(within):3d})" if len(within) else f"{'-':>10s}"


HEADER = " | ".join(
    (
        f"{'':26s}{'n':>3s}{'ref':>4s}",
        f"{'all tips, mm':17s}",
        f"{'told tips, share':22s}",
        "joint",
        "overlap   ",
        "time, s  ",
        "in 2 sd   ",
        "told in 2 sd",
    )
)


def table(records: Sequence[Record]) -> str:
    """Errors of the fit, and of what stands next to it: median, 95 % and (count) in millimetres."""
    rows = [(label, [r for r in records if chosen(r)]) for label, chosen in ROWS.items()]
    lines = [HEADER] + [fit_line(label, mine) for label, mine in rows if mine]
    lines += ["", f"{'':26s}" + " | ".join(f"{name:30s}" for name in OTHERS.values())]
    lines[-1] += f" | {LIMIT:35s} | missed"
    for label, mine in rows:
        if mine:
            cells = " | ".join(f"{median_and_95(values(mine, o, 'tips_mm')):30s}" for o in OTHERS)
            limit = median_and_95(allowed(values(mine, "truth", "limit_mm2").reshape(-1, 3, 3)))
            known = [m for m in map(missed, mine) if m is not None]
            lines.append(f"{label:26s}{cells} | {limit:35s} | {sum(known)} of {len(known)}")
    return "\n".join(lines)

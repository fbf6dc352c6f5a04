"""The metrics as they are shown: one table for figures, pages, tables and files."""

from __future__ import annotations

from typing import NamedTuple


class MetricText(NamedTuple):
    """A field of `Metrics`, its name with the unit, factor to that unit, and decimals."""

    field: str
    name: str
    scale: float = 1.0
    digits: int = 3
    higher_is_better: bool = True
    undefined: str = ""
    """What NaN means, where it can be."""


METRIC_TABLE = (
    MetricText("overlap", "overlap"),
    MetricText(
        "db_correlation", "dB correlation",
        undefined="one of the two dB images is constant, so it has no variance",
    ),
    MetricText("ssim", "SSIM"),
    MetricText("mask_iou", "mask IoU"),
    MetricText(
        "depth_rmse_m", "depth RMSE (mm)", 1e3, 2, False, "the two masks have no pixel in common"
    ),
    MetricText("chamfer_simulated_to_measured_m", "Chamfer sim. to meas. (mm)", 1e3, 2, False),
    MetricText("chamfer_measured_to_simulated_m", "Chamfer meas. to sim. (mm)", 1e3, 2, False),
)  # fmt: skip
"""The first ranks by a single number; reasons in `docs/metrics.md`."""

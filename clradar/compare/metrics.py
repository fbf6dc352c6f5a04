"""The record of a comparison: its metrics, and what a single number does not show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from clradar.compare.metric_table import METRIC_TABLE
from clradar.compare.similarity import METRICS
from clradar.compare.unmatched import UnmatchedObject
from clradar.constants import DYNAMIC_RANGE_DB

HEADLINE_METRIC = METRIC_TABLE[0].field
"""The field of `Metrics` for ranking by a single number."""

HIGHER_IS_BETTER = frozenset(metric.field for metric in METRIC_TABLE if metric.higher_is_better)
"""The metrics whose best value is the largest; for the rest it is the smallest."""

UNDEFINED = {metric.field: metric.undefined for metric in METRIC_TABLE if metric.undefined}
"""The metrics that can be NaN, and what NaN means there."""

GOOD_OVERLAP, POOR_CORRELATION = 0.8, 0.6
"""Beyond both of these the overlap and the dB correlation contradict each other.

Of one hand, simulated with another seed, alpha or shift, an overlap above the first comes with a
correlation above 0.65, however narrow the frame around the hand.
"""

POOR_OVERLAP, GOOD_CORRELATION = 0.6, 0.9
"""The same the other way round: the correlation does not see depth."""

NAMED_OBJECTS = 3
"""Objects that a remark describes; it counts the rest."""


@dataclass(frozen=True, slots=True)
class Metrics:
    """Agreement between a measured and a simulated image.

    `docs/metrics.md` has the formulas and the pixels that each metric uses.

    Attributes
    ----------
    overlap : float
        Cosine between the two depth maps as blurred points in space, in [0, 1]; 1 is best.
    db_correlation : float
        Pearson correlation of the clipped dB images, in [-1, 1]; 1 is best. NaN where one of them
        is constant.
    ssim : float
        Mean structural similarity of the clipped dB images scaled to [0, 1]; at most 1, the best.
    mask_iou : float
        Pixels in both masks over pixels in either, in [0, 1]; 1 is best.
    depth_rmse_m : float, metres
        Root mean square difference of depth over the pixels in both masks; 0 is best. NaN where
        the masks have no pixel in common.
    chamfer_simulated_to_measured_m : float, metres
        Mean distance from each simulated depth point to the nearest measured one; 0 is best.
    chamfer_measured_to_simulated_m : float, metres
        Mean distance from each measured depth point to the nearest simulated one; 0 is best.
    dynamic_range_db : float, decibel
        Level below each image's own maximum at which it was clipped and its mask cut.
    missing : tuple of UnmatchedObject
        Bright objects of the measurement that the simulation lacks, the largest share of the energy
        first; see `disagreement`.
    surplus : tuple of UnmatchedObject
        Bright objects of the simulation that the measurement lacks.

    Examples
    --------
    NaN, here of two masks without a common pixel, becomes None for JSON.

    >>> import clradar
    >>> metrics = clradar.Metrics(0.0, 0.1, 0.2, 0.0, float("nan"), 0.012, 0.009)
    >>> record = metrics.to_dict()
    >>> record["mask_iou"], record["depth_rmse_m"]
    (0.0, None)
    """

    overlap: float
    db_correlation: float
    ssim: float
    mask_iou: float
    depth_rmse_m: float
    chamfer_simulated_to_measured_m: float
    chamfer_measured_to_simulated_m: float
    dynamic_range_db: float = DYNAMIC_RANGE_DB
    missing: tuple[UnmatchedObject, ...] = ()
    surplus: tuple[UnmatchedObject, ...] = ()

    @property
    def misleading(self) -> bool:
        """Whether the overlap is good although another metric or an object says otherwise."""
        poor = self.db_correlation < POOR_CORRELATION or bool(self.missing or self.surplus)
        return self.overlap >= GOOD_OVERLAP and poor

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a single number does not show: objects of one image alone, and contradictions."""
        found = []
        if self.missing:
            found.append(f"missing from the simulation: {_listed(self.missing)}")
        if self.surplus:
            found.append(f"in the simulation alone: {_listed(self.surplus)}")
        pair = f"overlap {self.overlap:.2f}, but dB correlation {self.db_correlation:.2f}"
        if self.overlap >= GOOD_OVERLAP and self.db_correlation < POOR_CORRELATION:
            found.append(f"the metrics disagree: {pair} and mask IoU {self.mask_iou:.2f}")
        elif self.overlap < POOR_OVERLAP and self.db_correlation > GOOD_CORRELATION:
            found.append(
                f"the metrics disagree: {pair}, which does not see depth; the depth RMSE is "
                f"{1e3 * self.depth_rmse_m:.1f} mm"
            )
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """Return fields and remarks in types of strict JSON: None replaces NaN."""
        values = {name: float(getattr(self, name)) for name in (*METRICS, "dynamic_range_db")}
        return {
            **{name: None if math.isnan(value) else value for name, value in values.items()},
            "missing": [one.to_dict() for one in self.missing],
            "surplus": [one.to_dict() for one in self.surplus],
            "remarks": list(self.remarks),
        }


def _listed(objects: tuple[UnmatchedObject, ...]) -> str:
    texts = [str(one) for one in objects[:NAMED_OBJECTS]]
    more = len(objects) - NAMED_OBJECTS
    return "; ".join([*texts, *([f"and {more} more"] if more > 0 else [])])

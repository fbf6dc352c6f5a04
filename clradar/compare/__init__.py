"""Comparison of images: metrics, where two images disagree, and their spread over seeds."""

from clradar.compare.comparison import compare, compare_by, metrics_of
from clradar.compare.disagreement import disagreement
from clradar.compare.images import clipped_db, depth_map_of
from clradar.compare.metrics import HEADLINE_METRIC, HIGHER_IS_BETTER, UNDEFINED, Metrics
from clradar.compare.similarity import METRICS, SSIM_SIGMA, SSIM_WINDOW
from clradar.compare.spread import spread
from clradar.compare.unmatched import Disagreement, UnmatchedObject

__all__ = [
    "HEADLINE_METRIC",
    "HIGHER_IS_BETTER",
    "METRICS",
    "SSIM_SIGMA",
    "SSIM_WINDOW",
    "UNDEFINED",
    "Disagreement",
    "Metrics",
    "UnmatchedObject",
    "clipped_db",
    "compare",
    "compare_by",
    "depth_map_of",
    "disagreement",
    "metrics_of",
    "spread",
]

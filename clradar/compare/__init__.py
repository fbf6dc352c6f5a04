"""Comparison of images: metrics, where two images disagree, and their spread over seeds."""

from clradar.compare.images import clipped_db, depth_map_of
from clradar.compare.metrics import METRIC_TABLE, METRICS, Metrics, compare, metrics_of
from clradar.compare.unmatched import Disagreement, UnmatchedObject, disagreement

__all__ = [
    "METRICS",
    "METRIC_TABLE",
    "Disagreement",
    "Metrics",
    "UnmatchedObject",
    "clipped_db",
    "compare",
    "depth_map_of",
    "disagreement",
    "metrics_of",
]

"""Tiny plans for the tests of data sets: a hand of few triangles, 12 x 12 antennas, few voxels."""

from __future__ import annotations

from typing import Any

TINY: dict[str, Any] = {
    "seed": 3,
    "samples": 5,
    "poses": {"names": ["A", "B", "F"]},
    "hands": {"handedness": "both", "shape": "sampled", "edge_mm": 4},
    "placement": {
        "x_mm": {"uniform": [-10, 10]},
        "z_mm": {"normal": [300, 5]},
        "rotation_y_deg": {"uniform": [-20, 20]},
    },
    "alpha": {"palm": {"choice": [0.2, 0.8]}, "others": {"uniform": [0.3, 0.7]}},
    "impairments": {"snr_db": {"uniform": [10, 20]}},
    "radar": {"every": 8, "steps": 16},
    "simulation": {"samples_per_mm2": 0.05},
    "image": {"step_mm": 10},
    "output": {
        "shard_size": 2,
        "products": ["capture", "volume", "max_projection", "depth_map", "mesh", "joints"],
    },
}
"""A plan that uses most of what there is."""


def tiny(**tables: Any) -> dict[str, Any]:
    """Return `TINY` with some tables changed: keys of dictionaries are added, None removes."""
    found = dict(TINY)
    for name, value in tables.items():
        if value is None:
            del found[name]
        elif isinstance(value, dict) and isinstance(found.get(name), dict):
            merged = {**found[name], **value}
            found[name] = {key: item for key, item in merged.items() if item is not None}
        else:
            found[name] = value
    return found

"""Tiny plans for the tests of data sets: a hand of few triangles, 12 x 12 antennas, few voxels."""

import hashlib
from pathlib import Path
from typing import Any

from clradar.dataset import Plan
from clradar.dataset.plan.plan import plan_from
from clradar.files.toml_file import toml_document

DEVICE = "pocl"

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


def plan_of(**tables: Any) -> Plan:
    return plan_from(tiny(**tables), "plan", Path())


def light(**tables: Any) -> dict[str, Any]:
    """Return a plan of seven hands in three shards, of which nothing is simulated."""
    own = {
        "samples": 7,
        "impairments": None,
        "output": {"shard_size": 3, "products": ["joints", "mesh"]},
        "poses": {"names": ["A", "B"]},
    }
    return tiny(**{**own, **tables})


def light_plan(**tables: Any) -> Plan:
    return plan_from(light(**tables), "plan", Path())


def light_file(folder: Path, **tables: Any) -> Path:
    """Write a plan to a file."""
    path = folder / "plan.toml"
    path.write_text(toml_document(light(**tables)), encoding="utf-8")
    return path


PLAN, LIGHT = plan_of(), light_plan()


def digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of a data set but the lock, by name."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def flip_a_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)

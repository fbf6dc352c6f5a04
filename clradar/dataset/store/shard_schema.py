"""Schema of shards: arrays and labels with their axes, types and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.plan.hand_json import SHAPE_COLUMNS, angles_rad, shape_row
from clradar.dataset.sample import recipe_grid, recipe_radar
from clradar.hand import ANGLES, JOINT_NAMES, PART_NAMES
from clradar.model import Material
from clradar.model.material_file import material_of

FORMAT, VERSION = "dataset-shard", 1

COORDINATES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Field:
    """One array of every sample.

    Attributes
    ----------
    group : str
        The NXdata group that it is in.
    dataset : str
    axes : tuple of str
        Without the first, which is the sample; of a ragged array without the row.
    dtype : str
    units : str or None
    long_name : str
    ragged : bool
        Its length differs between samples: their rows are concatenated, and `<dataset>_first` has
        the first row of each sample.
    """

    group: str
    dataset: str
    axes: tuple[str, ...]
    dtype: str
    units: str | None
    long_name: str
    ragged: bool = False

    @property
    def place(self) -> str:
        """Path of the dataset in a shard."""
        return f"entry/{self.group}/{self.dataset}"

    @property
    def first_place(self) -> str:
        """Path of the first rows of the samples of a ragged array, and of its end."""
        return f"{self.place}_first"


FIELDS: Mapping[str, Field] = {
    "capture": Field(
        "capture", "data", ("tx", "rx", "frequency_hz"), "complex64", None, "complex response"
    ),
    "volume": Field("volume", "data", ("z_m", "y_m", "x_m"), "complex64", None, "complex image"),
    "max_projection": Field(
        "max_projection", "data", ("y_m", "x_m"), "float32", None, "maximum of the amplitude over z"
    ),
    "depth_map": Field(
        "depth_map", "data", ("y_m", "x_m"), "float32", "m", "depth of the maximum; NaN: nothing"
    ),
    "joints": Field(
        "joints", "data", ("joint", "coordinate"), "float64", "m", "joint centres, antenna frame"
    ),
    "mesh_vertices": Field(
        "mesh", "vertices", ("coordinate",), "float32", "m", "vertices, antenna frame", True
    ),
    "mesh_faces": Field("mesh", "faces", ("corner",), "int32", None, "vertices of faces", True),
    "mesh_part": Field("mesh", "part", (), "uint8", None, "index of each face's part", True),
}
"""Arrays of samples by their names in `Sample.arrays`."""


def fields_of_products(products: Sequence[str]) -> list[str]:
    """Return the arrays of products: those with the product's name, or with it before a "_"."""
    return [name for name in FIELDS if name in products or name.partition("_")[0] in products]


def data_bytes(recipe: Mapping[str, Any]) -> int:
    """Return the size of a sample's arrays, except meshes."""
    sizes = {name: len(axis.values) for name, axis in axes_of(recipe).items()}
    fields = [FIELDS[name] for name in fields_of_products(recipe["products"])]
    return sum(
        np.dtype(field.dtype).itemsize * prod(sizes[axis] for axis in field.axes)
        for field in fields
        if not field.ragged
    )


@dataclass(frozen=True, slots=True)
class Label:
    """One label of a sample, from its recipe."""

    axes: tuple[str, ...]
    units: str | None
    long_name: str


LABELS: Mapping[str, Label] = {
    "pose": Label((), None, "name of the pose"),
    "handedness": Label((), None, "right or left"),
    "angles_rad": Label(("joint", "angle"), "rad", "joint angles"),
    "shape": Label(("shape_parameter",), None, "shape of the hand; NaN: of a rig"),
    "rig": Label((), None, "file of the rig, if any"),
    "center_m": Label(("coordinate",), "m", "centre of the hand's bounding box before its turn"),
    "rotation_rad": Label(("coordinate",), "rad", "turns about x, then y, then z"),
    "alpha": Label(("part",), None, "0 specular to 1 diffuse"),
    "roughness_rms_m": Label(("part",), "m", "RMS height of the roughness"),
    "correlation_length_m": Label(("part",), "m", "of the roughness; NaN: smooth"),
    "coating_thickness_m": Label(("part",), "m", "of the coating; NaN: none"),
    "sequence": Label((), None, "number of the sequence of frames"),
    "frame": Label((), None, "number of the frame in its sequence"),
    "time_s": Label((), "s", "when the frame begins in its sequence"),
    "recipe": Label((), None, "all that the sample is made of, JSON"),
    "made_with": Label((), None, "versions and device, JSON"),
}


OF_MATERIALS = ("roughness_rms_m", "correlation_length_m", "coating_thickness_m")
"""Labels of samples of the physical estimator, which have no "alpha"."""


OF_SEQUENCES = ("sequence", "frame", "time_s")
"""Labels of samples that are frames of a sequence."""


def labels_of(recipe: Mapping[str, Any]) -> dict[str, Label]:
    """Return those of `LABELS` that a sample has."""
    others: tuple[str, ...] = ("alpha",) if "material" in recipe else OF_MATERIALS
    if "movement" not in recipe:
        others += OF_SEQUENCES
    return {name: label for name, label in LABELS.items() if name not in others}


def label_values(recipes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return all labels but the last two: lists of text, or arrays."""
    return {
        "pose": [r["pose"]["name"] for r in recipes],
        "handedness": [r["hand"]["handedness"] for r in recipes],
        "angles_rad": np.array([angles_rad(r["pose"]) for r in recipes]),
        "shape": np.array([shape_row(r["hand"].get("shape")) for r in recipes]),
        "rig": [Path(r["hand"]["rig"]["file"]).name if "rig" in r["hand"] else "" for r in recipes],
        "center_m": np.array([r["placement"]["center_m"] for r in recipes]),
        "rotation_rad": np.array([r["placement"]["rotation_rad"] for r in recipes]),
        **_surface_labels(recipes),
        **_sequence_labels(recipes),
    }


def _sequence_labels(recipes: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    if "movement" not in recipes[0]:
        return {}
    moving = [r["movement"] for r in recipes]
    return {
        "sequence": np.array([own["sequence"] for own in moving], dtype=np.int64),
        "frame": np.array([own["frame"] for own in moving], dtype=np.int32),
        "time_s": np.array([own["start_s"] for own in moving], dtype=np.float64),
    }


def _surface_labels(recipes: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Return alpha, or lengths of the materials, of every part: shape (n, parts)."""
    if "material" not in recipes[0]:
        return {"alpha": np.array([[r["alpha"][name] for name in PART_NAMES] for r in recipes])}
    rows = [[material_of(r["material"][name]) for name in PART_NAMES] for r in recipes]
    lengths = [[_lengths_m(own) for own in row] for row in rows]
    return dict(zip(OF_MATERIALS, np.moveaxis(np.array(lengths), 2, 0), strict=True))


def _lengths_m(own: Material) -> tuple[float, ...]:
    correlation_m, coating = own.correlation_length_m, own.coating
    return (
        own.roughness_rms_m,
        np.nan if correlation_m is None else correlation_m,
        np.nan if coating is None else coating.thickness_m,
    )


@dataclass(frozen=True, slots=True)
class Axis:
    """The coordinates of one axis: numbers, or names."""

    values: Any
    units: str | None


def axes_of(recipe: Mapping[str, Any]) -> dict[str, Axis]:
    """Return the axes that the samples of a plan share."""
    found = {
        "joint": Axis(JOINT_NAMES, None),
        "coordinate": Axis(COORDINATES, None),
        "angle": Axis(ANGLES, None),
        "part": Axis(PART_NAMES, None),
        "shape_parameter": Axis(SHAPE_COLUMNS, None),
    }
    if "capture" in recipe["products"]:
        array, waveform = recipe_radar(recipe)
        found["tx"] = Axis(np.arange(array.n_tx, dtype=np.int32), None)
        found["rx"] = Axis(np.arange(array.n_rx, dtype=np.int32), None)
        found["frequency_hz"] = Axis(waveform.frequencies_hz, "Hz")
        found["tx_m"] = Axis(array.tx_m, "m")
        found["rx_m"] = Axis(array.rx_m, "m")
    if recipe["image"] is not None:
        grid = recipe_grid(recipe)
        for name in ("x_m", "y_m", "z_m"):
            found[name] = Axis(getattr(grid, name), "m")
    return found

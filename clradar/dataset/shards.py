"""Shards: netCDF-4 files of samples, which xarray opens; `ARRAYS` and `LABELS` are their schema.

The same samples give the same bytes: no time is stored, and the order of writing is fixed. Version
1, of clradar 0.2, had the same arrays at other places (`place_of`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clradar.dataset.plan.plan import Plan
from clradar.dataset.sample import RECIPE_VERSION, Sample, SamplePlan, read_recipe, recipe
from clradar.files.atomic import replacing, require_space
from clradar.files.failures import fail, reading, regular_file_size
from clradar.files.json_file import to_json
from clradar.files.records import OpenRecord, Whole
from clradar.hand import ANGLES, JOINT_NAMES, PART_NAMES

EXPECTED = "a shard of a data set (HDF5)"
FORMAT, VERSION = "dataset-shard", 2

SPARE_BYTES = 2**21  # of a disk, beside the arrays of a sample
LIBRARY = ("v110", "v110")  # versions of the HDF5 file format that are written
FAILED = {1: "entry/failed", VERSION: "failed/reasons"}
"""Place, by version, of the samples that could not be made, and why: a JSON text for each."""

SHAPE_PARAMETERS = (
    "length_m",
    "breadth_m",
    *(f"finger_lengths.{digit}" for digit in ("thumb", "index", "middle", "ring", "pinky")),
    "girth",
)


class Aside(OpenRecord):
    """A sample that was set aside, since no attempt made it, and the reason on one line."""

    sample: Whole
    reason: str
    attempts: Whole


class Field(NamedTuple):
    """An array or a label of every sample; `axes` are without the first, which is the sample."""

    axes: tuple[str, ...]
    units: str | None
    long_name: str
    dtype: str = ""  # of a label; "text" is UTF-8


MESH = "mesh_"  # arrays whose names begin so differ in length: they have a group for each sample
_YX, _XYZ, _PART = ("y_m", "x_m"), ("coordinate",), ("part",)
ARRAYS: Mapping[str, Field] = {
    "capture": Field(("tx", "rx", "frequency_hz"), None, "complex response"),
    "volume": Field(("z_m", *_YX), None, "complex image"),
    "max_projection": Field(_YX, None, "maximum of the amplitude over z"),
    "depth_map": Field(_YX, "m", "depth of the maximum; NaN: nothing"),
    "joints": Field(("joint", *_XYZ), "m", "joint centres, antenna frame"),
    "mesh_vertices": Field(_XYZ, "m", "vertices, antenna frame"),
    "mesh_faces": Field(("corner",), None, "vertices of faces"),
    "mesh_part": Field((), None, "index of each face's part"),
}
"""Arrays of samples by their names in `Sample.arrays`."""

LABELS: Mapping[str, Field] = {
    "sample": Field((), None, "number of the sample in the plan", "int64"),
    "pose": Field((), None, "name of the pose", "text"),
    "handedness": Field((), None, "right or left", "text"),
    "angles_rad": Field(("joint", "angle"), "rad", "joint angles", "float64"),
    "shape": Field(("shape_parameter",), None, "shape of the hand; NaN: of a rig", "float64"),
    "rig": Field((), None, "file of the rig, if any", "text"),
    "center_m": Field(_XYZ, "m", "centre of the hand's bounding box before its turn", "float64"),
    "rotation_rad": Field(_XYZ, "rad", "turns about x, then y, then z", "float64"),
    "alpha": Field(_PART, None, "0 specular to 1 diffuse", "float64"),
    "roughness_rms_m": Field(_PART, "m", "RMS height of the roughness", "float64"),
    "correlation_length_m": Field(_PART, "m", "of the roughness; NaN: smooth", "float64"),
    "coating_thickness_m": Field(_PART, "m", "of the coating; NaN: none", "float64"),
    "sequence": Field((), None, "number of the sequence", "int64"),
    "frame": Field((), None, "number of the frame in it", "int32"),
    "time_s": Field((), "s", "when the frame begins in it", "float64"),
    "recipe": Field((), None, "all that the sample is made of, JSON", "text"),
    "made_with": Field((), None, "versions and device, JSON", "text"),
}
NAMES = ("pose", "handedness", "rig")  # labels that are coordinates of the samples


def _labels(own: SamplePlan, made_with: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of those of `LABELS` that a sample has; None is NaN."""
    plan, pose, shape = own.plan, own.pose, [None] * len(SHAPE_PARAMETERS)
    for hand in (table.shape for table in plan.hands.shapes):
        shape = [hand.length_m, hand.breadth_m, *hand.finger_lengths, hand.girth]
    found: dict[str, Any] = {
        "sample": own.sample,
        "pose": pose.name,
        "handedness": plan.hands.handedness,
        "angles_rad": [astuple(pose.angles(name)) for name in JOINT_NAMES],
        "shape": shape,
        "rig": "".join(Path(rig.file).name for rig in plan.hands.rigs),
        "center_m": plan.placement.metres,
        "rotation_rad": plan.placement.radians,
    }
    if plan.alpha is not None:
        found["alpha"] = [*plan.alpha.of_parts.values()]
    if plan.material is not None:
        parts = [*plan.material.of_parts.values()]
        found["roughness_rms_m"] = [part.roughness_rms_m for part in parts]
        found["correlation_length_m"] = [part.correlation_length_m for part in parts]
        found["coating_thickness_m"] = [getattr(p.coating, "thickness_m", None) for p in parts]
    if plan.movement is not None:
        found |= {"sequence": own.number, "frame": own.frame, "time_s": own.start_s}
    return found | {
        "recipe": to_json("recipe", own.record),
        "made_with": to_json("made_with", made_with),
    }


def labels_of(plan: Plan) -> dict[str, Field]:
    """Return those of `LABELS` that the samples of a plan have."""
    return {name: LABELS[name] for name in _labels(SamplePlan(plan, 0), {})}


def arrays_of(products: Sequence[str]) -> dict[str, Field]:
    """Return the arrays of products: those with the product's name, or with it before a "_"."""
    return {
        name: field
        for name, field in ARRAYS.items()
        if name in products or name.partition("_")[0] in products
    }


def axes_of(plan: Plan) -> dict[str, Any]:
    """Return the coordinates that the samples of a plan share."""
    found: dict[str, Any] = {
        "joint": JOINT_NAMES,
        "coordinate": ("x", "y", "z"),
        "angle": ANGLES,
        "part": PART_NAMES,
        "shape_parameter": SHAPE_PARAMETERS,
    }
    if "capture" in plan.output.products:
        array = plan.radar.antennas
        found |= {"tx": np.arange(array.n_tx, dtype="i4"), "rx": np.arange(array.n_rx, dtype="i4")}
        found["frequency_hz"] = plan.radar.waveform.frequencies_hz
        found |= {"tx_m": array.tx_m, "rx_m": array.rx_m}
    if plan.keeps_images:
        found |= {name: getattr(plan.image.grid, name) for name in ("x_m", "y_m", "z_m")}
    return found


def dims_of(coordinate: str) -> tuple[str, ...]:
    """Return the axes of a coordinate: itself, but of the places of antennas."""
    return (coordinate[:2], *_XYZ) if coordinate in ("tx_m", "rx_m") else (coordinate,)


# Writing


@contextmanager
def new_shard(path: Path, plan: Plan) -> Iterator[ShardWriter]:
    """Yield a writer of samples; the shard is put in its place when it is whole."""
    import h5py

    with (
        replacing(path, force=True) as temporary,
        h5py.File(temporary, "x", libver=LIBRARY) as file,
    ):
        writer = ShardWriter(file, temporary, plan)
        yield writer
        writer.finish()


class ShardWriter:
    """Writes a shard one sample after the other; their arrays are not kept in memory."""

    def __init__(self, file: Any, path: Path, plan: Plan) -> None:
        self._file, self._path, self._plan = file, path, plan
        self._labels: list[dict[str, Any]] = []
        self._failed: list[str] = []

    def fail(self, aside: Aside) -> None:
        """Note that a sample could not be made."""
        self._failed.append(to_json("aside", aside.model_dump()))

    def add(self, sample: Sample, made_with: Mapping[str, Any]) -> None:
        """Write a sample, with its versions and device, JSON values."""
        # First, since HDF5 cannot close a file for which the disk is full.
        size_bytes = sum(array.nbytes for array in sample.arrays.values())
        free = self._path.with_name(f"{self._path.stem}-space.tmp")
        require_space(free, size_bytes + SPARE_BYTES)
        drawn = read_recipe(sample.recipe)
        row = len(self._labels)
        self._labels.append(_labels(drawn, made_with))
        for name, field in ((n, own) for n, own in ARRAYS.items() if n in sample.arrays):
            array = sample.arrays[name]
            if name.startswith(MESH):
                self._write(_mesh_place(drawn.sample, name), field, array)
                continue
            if name not in self._file:
                shape = array.shape
                sizes = {"maxshape": (None, *shape), "chunks": (1, *shape)}
                self._write(name, field, array[None][:0], **sizes)
            data = self._file[name]
            data.resize(row + 1, axis=0)
            data[row] = array
            data.flush()  # as in `_write`

    def finish(self) -> None:
        """Write labels, axes, and what failed."""
        attributes = {"clradar_format": FORMAT, "clradar_version": VERSION}
        self._file.attrs.update(attributes, Conventions="CF-1.11")
        if self._failed:
            self._write(FAILED[VERSION], Field((), None, "what failed, and why"), self._failed)
        if not self._labels:
            return
        axes = {}
        for name in self._labels[0]:
            label, given = LABELS[name], [labels[name] for labels in self._labels]
            values = given if label.dtype == "text" else np.array(given, dtype=label.dtype)
            self._write(name, label, values)
            axes[name] = ("sample", *label.axes)
        for name, values in axes_of(self._plan).items():
            units = {"m": "m", "hz": "Hz"}.get(name.rpartition("_")[2])
            self._write(name, Field((), units, name), values)
            axes[name] = dims_of(name)
        axes |= {name: ("sample", *ARRAYS[name].axes) for name in ARRAYS if name in self._file}
        for name in axes:
            if axes[name] == (name,):
                self._file[name].make_scale(name)
        for name, own in axes.items():
            for i, axis in enumerate(own):
                if axis != name:
                    self._file[name].dims[i].attach_scale(self._file[axis])
        shared = [name for name in ("tx_m", "rx_m") if name in axes]
        self._file.attrs["coordinates"] = " ".join((*NAMES, *shared))

    def _write(self, place: str, field: Field, values: Any, **sizes: Any) -> None:
        import h5py

        is_text = not isinstance(values, np.ndarray)
        if is_text:  # UTF-8 of a fixed length
            encoded = np.char.encode(values, "utf-8")
            values = encoded.astype(h5py.string_dtype("utf-8", encoded.itemsize))
        made = self._file.create_dataset(
            place, data=values, **{"chunks": values.shape, **sizes}, shuffle=True, fletcher32=True,
            compression="gzip", compression_opts=self._plan.output.compression, track_times=False,
        )  # fmt: skip
        made.attrs["long_name"] = field.long_name
        if field.units is not None:
            made.attrs["units"] = field.units
        if is_text:
            made.attrs["_Encoding"] = "utf-8"
        made.flush()  # else its place in the file would depend on when Python closes it


def _mesh_place(sample: int, name: str) -> str:
    return f"mesh/{sample}/{name.removeprefix(MESH)}"


# Reading


@contextmanager
def opened_shard(path: Path) -> Iterator[Any]:
    """Open a shard for reading: a file of one's own, or one whose SHA-256 is known."""
    import h5py

    regular_file_size(path, EXPECTED)
    with reading(path, EXPECTED), h5py.File(path, "r") as file:
        if file.attrs.get("clradar_format") != FORMAT:
            fail(path, EXPECTED, "another HDF5 file")
        if (version := file.attrs["clradar_version"]) > VERSION:
            fail(path, f"version {VERSION} or older", f"{version}; update clradar")
        yield file


def place_of(file: Any, name: str) -> str:
    """Return the place of an array, but of a mesh, or of a label in an open shard."""
    if file.attrs["clradar_version"] > 1:
        return name
    return f"entry/labels/{name}" if name in LABELS else f"entry/{name}/data"


def samples_of(file: Any) -> list[int]:
    """Return the numbers of the samples in an open shard."""
    place = place_of(file, "sample")
    return file[place][:].tolist() if place in file else []


def failed_of(file: Any) -> dict[int, Aside]:
    """Return the samples that failed, and why, by their numbers."""
    texts = file.get(FAILED[file.attrs["clradar_version"]], ())
    found = (Aside(**json.loads(text)) for text in texts)
    return {aside.sample: aside for aside in found}


def read_array(file: Any, name: str, row: int) -> Any:
    """Return one of `ARRAYS` of the sample in a row of an open shard."""
    if not name.startswith(MESH):
        return file[place_of(file, name)][row]
    if file.attrs["clradar_version"] > 1:
        return file[_mesh_place(file["sample"][row], name)][:]
    place = f"entry/mesh/{name.removeprefix(MESH)}"  # of all samples, one after the other
    first, end = file[f"{place}_first"][row : row + 2].tolist()
    return file[place][first:end]


def read_stored(path: Path, sample: int, plan: Plan) -> tuple[Sample, dict[str, Any]]:
    """Return a stored sample of a plan, and the versions and the device that made it."""
    with opened_shard(path) as file:
        there = samples_of(file)
        if there.count(sample) != 1:
            fail(path, f"sample {sample} once", f"{there.count(sample)} times")
        row = there.index(sample)
        arrays = {name: read_array(file, name, row) for name in arrays_of(plan.output.products)}
        texts = (file[place_of(file, name)][row] for name in ("recipe", "made_with"))
        made_of, made_with = map(json.loads, texts)
        if made_of["version"] != RECIPE_VERSION:  # of clradar 0.2, which had other keys
            made_of = recipe(plan, sample)
        return Sample(made_of, arrays), made_with

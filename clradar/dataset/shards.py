"""Shards: HDF5 files of samples in the NeXus convention; `ARRAYS` and `LABELS` are their schema.

The same samples give the same bytes: no time is stored, and the order of writing is fixed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.plan.hands import PlanMaterials
from clradar.dataset.plan.plan import Plan
from clradar.dataset.sample import RECIPE_VERSION, Sample, SamplePlan, read_recipe, recipe
from clradar.files.atomic import replacing, require_space
from clradar.files.failures import fail, reading, regular_file_size
from clradar.files.json_file import to_json
from clradar.files.records import OpenRecord, Whole
from clradar.hand import ANGLES, JOINT_NAMES, PART_NAMES

EXPECTED = "a shard of a data set (HDF5)"
FORMAT, VERSION = "dataset-shard", 1

SPARE_BYTES = 2**21  # of a disk, beside the arrays of a sample
RAGGED_ROWS = 2**14
LIBRARY = ("v110", "v110")  # versions of the HDF5 file format that are written
FAILED = "entry/failed"
"""Place of the samples that could not be made, and why: a JSON text for each."""

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


@dataclass(frozen=True, slots=True)
class Field:
    """An array or a label of every sample; `axes` are without the first, which is the sample."""

    place: str
    axes: tuple[str, ...]
    units: str | None
    long_name: str
    dtype: str = ""  # of a label; "text" is UTF-8
    value: Callable[[SamplePlan], Any] | None = None  # of a label that is no JSON
    of: str | None = None  # a table of the plan without which there is no such label

    @property
    def ragged(self) -> bool:
        """Whether rows of all samples are concatenated; `<place>_first` is where each begins."""
        return self.place.startswith("entry/mesh/")


_YX, _XYZ = ("y_m", "x_m"), ("coordinate",)
_PAIRS = ("tx", "rx", "frequency_hz")
ARRAYS: Mapping[str, Field] = {
    name: Field(f"entry/{place}", *rest)
    for name, place, *rest in (
        ("capture", "capture/data", _PAIRS, None, "complex response"),
        ("volume", "volume/data", ("z_m", *_YX), None, "complex image"),
        ("max_projection", "max_projection/data", _YX, None, "maximum of the amplitude over z"),
        ("depth_map", "depth_map/data", _YX, "m", "depth of the maximum; NaN: nothing"),
        ("joints", "joints/data", ("joint", *_XYZ), "m", "joint centres, antenna frame"),
        ("mesh_vertices", "mesh/vertices", _XYZ, "m", "vertices, antenna frame"),
        ("mesh_faces", "mesh/faces", ("corner",), None, "vertices of faces"),
        ("mesh_part", "mesh/part", (), None, "index of each face's part"),
    )
}
"""Arrays of samples by their names in `Sample.arrays`."""


def _angles_rad(sample: SamplePlan) -> list[Any]:
    return [astuple(sample.pose.angles(name)) for name in JOINT_NAMES]


def _shape(sample: SamplePlan) -> list[float]:
    if not sample.plan.hands.shapes:
        return [float("nan")] * len(SHAPE_PARAMETERS)
    shape = sample.plan.hands.shapes[0].shape
    return [shape.length_m, shape.breadth_m, *shape.finger_lengths, shape.girth]


def _of_parts(name: str, sample: SamplePlan) -> list[float | None]:
    """A length of the material of each part, or of its coating; None becomes NaN."""
    materials = (sample.plan.material or PlanMaterials()).of_parts.values()
    return [getattr(own, name, getattr(own.coating, name, None)) for own in materials]


_LABELS: Sequence[Any] = (
    ("sample", (), None, "number of the sample in the plan", "int64", lambda s: s.sample),
    ("pose", (), None, "name of the pose", "text", lambda s: s.pose.name),
    ("handedness", (), None, "right or left", "text", lambda s: s.plan.hands.handedness),
    ("angles_rad", ("joint", "angle"), "rad", "joint angles", "float64", _angles_rad),
    ("shape", ("shape_parameter",), None, "shape of the hand; NaN: of a rig", "float64", _shape),
    (
        "rig", (), None, "file of the rig, if any", "text",
        lambda s: "".join(Path(rig.file).name for rig in s.plan.hands.rigs),
    ),
    (
        "center_m", _XYZ, "m", "centre of the hand's bounding box before its turn", "float64",
        lambda s: s.plan.placement.metres,
    ),
    (
        "rotation_rad", _XYZ, "rad", "turns about x, then y, then z", "float64",
        lambda s: s.plan.placement.radians,
    ),
    (
        "alpha", ("part",), None, "0 specular to 1 diffuse", "float64",
        lambda s: [*s.plan.alpha.of_parts.values()], "alpha",
    ),
    (
        "roughness_rms_m", ("part",), "m", "RMS height of the roughness", "float64",
        partial(_of_parts, "roughness_rms_m"), "material",
    ),
    (
        "correlation_length_m", ("part",), "m", "of the roughness; NaN: smooth", "float64",
        partial(_of_parts, "correlation_length_m"), "material",
    ),
    (
        "coating_thickness_m", ("part",), "m", "of the coating; NaN: none", "float64",
        partial(_of_parts, "thickness_m"), "material",
    ),
    ("sequence", (), None, "number of the sequence", "int64", lambda s: s.number, "movement"),
    ("frame", (), None, "number of the frame in it", "int32", lambda s: s.frame, "movement"),
    ("time_s", (), "s", "when the frame begins in it", "float64", lambda s: s.start_s, "movement"),
    (
        "recipe", (), None, "all that the sample is made of, JSON", "text",
        lambda s: to_json("recipe", s.record),
    ),
    ("made_with", (), None, "versions and device, JSON", "text"),
)  # fmt: skip
LABELS = {name: Field(f"entry/labels/{name}", *rest) for name, *rest in _LABELS}


def labels_of(plan: Plan) -> dict[str, Field]:
    """Return those of `LABELS` that the samples of a plan have."""
    return {n: own for n, own in LABELS.items() if own.of is None or getattr(plan, own.of)}


def arrays_of(products: Sequence[str]) -> dict[str, Field]:
    """Return the arrays of products: those with the product's name, or with it before a "_"."""
    return {
        name: field
        for name, field in ARRAYS.items()
        if name in products or name.partition("_")[0] in products
    }


def axes_of(plan: Plan) -> dict[str, Any]:
    """Return the coordinates of the axes that the samples of a plan share."""
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


# Writing


@contextmanager
def new_shard(path: Path, plan: Plan) -> Iterator[ShardWriter]:
    """Yield a writer of samples; the shard is put in its place when it is whole."""
    import h5py

    with (
        replacing(path, force=True) as temporary,
        h5py.File(temporary, "x", libver=LIBRARY) as file,
    ):
        writer = ShardWriter(file, temporary, plan.output.compression)
        yield writer
        writer.finish()


class ShardWriter:
    """Writes a shard one sample after the other; their arrays are not kept in memory."""

    def __init__(self, file: Any, path: Path, compression: int) -> None:
        self._file, self._path = file, path
        self._filters = {
            "compression": "gzip", "compression_opts": compression, "shuffle": True,
            "fletcher32": True, "track_times": False,
        }  # fmt: skip
        self._labels: dict[str, list[Any]] = {}
        self._first: dict[str, list[int]] = {}
        self._failed: list[str] = []
        file.attrs.update(
            NX_class="NXroot", default="entry", clradar_format=FORMAT, clradar_version=VERSION
        )
        self._group("entry", NX_class="NXentry")

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
        if not self._labels:
            self._begin(drawn.plan, sample.arrays)
        for name, values in self._labels.items():
            value = LABELS[name].value
            values.append(to_json(name, made_with) if value is None else value(drawn))
        for name, first in self._first.items():
            array = sample.arrays[name] if ARRAYS[name].ragged else sample.arrays[name][None]
            data, end = self._file[ARRAYS[name].place], first[-1] + len(array)
            data.resize(end, axis=0)
            data[first[-1] :] = array
            data.flush()  # as in `_dataset`
            first.append(end)

    def _begin(self, plan: Plan, arrays: Mapping[str, np.ndarray]) -> None:
        """Make the groups and the empty arrays of all samples, with their axes."""
        self._labels = {name: [] for name in labels_of(plan)}
        self._group("entry/labels", NX_class="NXcollection")
        coordinates = self._group("entry/axes", NX_class="NXcollection")
        for name, values in axes_of(plan).items():
            units = {"m": "m", "hz": "Hz"}.get(name.rpartition("_")[2])
            self._dataset(Field(f"entry/axes/{name}", (), units, name), values)
        fields = {name: field for name, field in ARRAYS.items() if name in arrays}
        # What viewers draw at once.
        drawn = [name for name in ("max_projection", "depth_map", *fields) if name in fields]
        self._file["entry"].attrs["default"] = fields[drawn[0]].place.split("/")[1]
        for name, field in fields.items():
            place, signal = field.place.rsplit("/", 1)
            if place not in self._file:
                axes = {} if field.ragged else {"axes": ["sample", *field.axes]}
                title = {"signal": signal, "title": field.long_name}
                group = self._group(place, NX_class="NXdata", **title, **axes)
                for axis in (*field.axes, *(("tx_m", "rx_m") if name == "capture" else ())):
                    if axis in coordinates:
                        group[axis] = coordinates[axis]
            shape = arrays[name].shape[1:] if field.ragged else arrays[name].shape
            made = self._made(
                field, shape=(0, *shape), maxshape=(None, *shape), dtype=arrays[name].dtype,
                chunks=(RAGGED_ROWS if field.ragged else 1, *shape),
            )  # fmt: skip
            if field.axes[-2:] == ("y_m", "x_m"):
                made.attrs["interpretation"] = "image"
            self._first[name] = [0]

    def finish(self) -> None:
        """Write labels, where ragged arrays begin, and what failed."""
        for name, given in self._labels.items():
            label = LABELS[name]
            values = given if label.dtype == "text" else np.array(given, dtype=label.dtype)
            made = self._dataset(label, values)
            if label.axes:
                made.attrs["axes"] = ["sample", *label.axes]
        for name, first in self._first.items():
            place = ARRAYS[name].place
            if ARRAYS[name].ragged:
                title = f"where {place.rsplit('/', 1)[1]} begin, and end"
                self._dataset(Field(f"{place}_first", (), None, title), np.array(first, np.int64))
            group = self._file[place].parent
            if "sample" not in group:
                group["sample"] = self._file["entry/labels/sample"]
        if self._failed:
            self._dataset(Field(FAILED, (), None, "what failed, and why, JSON"), self._failed)

    def _group(self, name: str, **attributes: Any) -> Any:
        group = self._file.create_group(name)
        group.attrs.update(attributes)
        return group

    def _dataset(self, field: Field, values: Any) -> Any:
        if not isinstance(values, np.ndarray):  # texts: UTF-8 of a fixed length
            import h5py

            encoded = np.char.encode(values, "utf-8")
            values = encoded.astype(h5py.string_dtype("utf-8", encoded.itemsize))
        made = self._made(field, data=values, chunks=values.shape)
        made.flush()  # else its place in the file would depend on when Python closes it
        return made

    def _made(self, field: Field, **how: Any) -> Any:
        made = self._file.create_dataset(field.place, **how, **self._filters)
        units, name = field.units, field.long_name
        # Viewers write one or the other; names of axes have their unit already.
        own = units is None or name.endswith(f"_{units}")
        made.attrs["long_name"] = name if own else f"{name} ({units})"
        if units is not None:
            made.attrs["units"] = units
        return made


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


def samples_of(file: Any) -> list[int]:
    """Return the numbers of the samples in an open shard."""
    place = LABELS["sample"].place
    return file[place][:].tolist() if place in file else []


def failed_of(file: Any) -> dict[int, Aside]:
    """Return the samples that failed, and why, by their numbers."""
    found = (Aside(**json.loads(text)) for text in (file[FAILED][:] if FAILED in file else ()))
    return {aside.sample: aside for aside in found}


def read_array(file: Any, name: str, row: int) -> Any:
    """Return one of `ARRAYS` of the sample in a row of an open shard."""
    place = ARRAYS[name].place
    if ARRAYS[name].ragged:
        first, end = file[f"{place}_first"][row : row + 2].tolist()
        return file[place][first:end]
    return file[place][row]


def read_sample(path: Path, sample: int, plan: Plan) -> tuple[Sample, dict[str, Any]]:
    """Return a stored sample of a plan, and the versions and the device that made it."""
    with opened_shard(path) as file:
        there = samples_of(file)
        if there.count(sample) != 1:
            fail(path, f"sample {sample} once", f"{there.count(sample)} times")
        row = there.index(sample)
        stored = [name for name, field in ARRAYS.items() if field.place in file]
        arrays = {name: read_array(file, name, row) for name in stored}
        made_of = json.loads(file[LABELS["recipe"].place][row])
        if made_of["version"] != RECIPE_VERSION:  # of clradar 0.2, which had other keys
            made_of = recipe(plan, sample)
        return Sample(made_of, arrays), json.loads(file[LABELS["made_with"].place][row])

"""Shards: HDF5 files of samples in the NeXus convention, their schema, writing and reading.

The same samples give the same bytes: no time is stored, and the order of writing is fixed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.plan.hands import SHAPE_COLUMNS, Alpha, angles_rad, shape_row
from clradar.dataset.plan.materials import PlanMaterials
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import VERSION as RECIPES
from clradar.dataset.plan.recipe import SamplePlan, metres, radians, read_recipe
from clradar.dataset.plan.recipe import recipe as recipe_of
from clradar.dataset.sample import Sample, radar_of
from clradar.files.atomic import replacing, require_space
from clradar.files.failures import fail, reading, regular_file_size
from clradar.files.json_text import parse_object
from clradar.hand import ANGLES, JOINT_NAMES, PART_NAMES
from clradar.jobs.outcome import Aside
from clradar.model import Material
from measurement_io.confined import hdf5_guard
from measurement_io.confined.reading import run

EXPECTED = "a shard of a data set (HDF5)"
FORMAT, VERSION = "dataset-shard", 1

CHUNK_BYTES = 2**20
SMALL_BYTES = 2**16
RAGGED_ROWS = 2**14
LIBRARY = ("v110", "v110")
"""Versions of the HDF5 file format that are written."""

SHOWN_FIRST = ("max_projection", "depth_map")
"""What viewers draw at once, where a shard has it."""

FAILED = "entry/failed"
"""Place of the samples that could not be made, and why: a JSON text for each."""


# Schema


@dataclass(frozen=True, slots=True)
class Field:
    """One array of every sample.

    `axes` are without the first, which is the sample. The length of a `ragged` one differs between
    samples: their rows are concatenated, and `<dataset>_first` has the first row of each sample.
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


_ZYX, _YX = ("z_m", "y_m", "x_m"), ("y_m", "x_m")
_PAIRS, _JOINTS = ("tx", "rx", "frequency_hz"), ("joint", "coordinate")
FIELDS: Mapping[str, Field] = {
    "capture": Field("capture", "data", _PAIRS, "complex64", None, "complex response"),
    "volume": Field("volume", "data", _ZYX, "complex64", None, "complex image"),
    "max_projection": Field(
        "max_projection", "data", _YX, "float32", None, "maximum of the amplitude over z"
    ),
    "depth_map": Field(
        "depth_map", "data", _YX, "float32", "m", "depth of the maximum; NaN: nothing"
    ),
    "joints": Field("joints", "data", _JOINTS, "float64", "m", "joint centres, antenna frame"),
    "mesh_vertices": Field(
        "mesh", "vertices", ("coordinate",), "float32", "m", "vertices, antenna frame", True
    ),
    "mesh_faces": Field("mesh", "faces", ("corner",), "int32", None, "vertices of faces", True),
    "mesh_part": Field("mesh", "part", (), "uint8", None, "index of each face's part", True),
}
"""Arrays of samples by their names in `Sample.arrays`."""


@dataclass(frozen=True, slots=True)
class Label:
    """One label of a sample; only those that have `of` in their plan have it."""

    value: Callable[[SamplePlan], Any]
    long_name: str
    units: str | None = None
    axes: tuple[str, ...] = ()
    of: str | None = None
    dtype: str = "float64"


def _of_parts(value: Callable[[Material], float | None]) -> Callable[[SamplePlan], Any]:
    """A number of the material of each part; None becomes NaN."""
    return lambda d: [value(own) for own in (d.plan.material or PlanMaterials()).of_parts.values()]


_XYZ, _PARTS = ("coordinate",), ("part",)
LABELS: Mapping[str, Label] = {
    "pose": Label(lambda d: d.pose.name, "name of the pose"),
    "handedness": Label(lambda d: d.plan.hands.handedness, "right or left"),
    "angles_rad": Label(
        lambda d: angles_rad(d.pose), "joint angles", "rad", ("joint", "angle")
    ),
    "shape": Label(
        lambda d: shape_row(d.plan.hands.shapes[0].shape if d.plan.hands.shapes else None),
        "shape of the hand; NaN: of a rig", None, ("shape_parameter",),
    ),
    "rig": Label(
        lambda d: "".join(Path(rig.file).name for rig in d.plan.hands.rigs),
        "file of the rig, if any",
    ),
    "center_m": Label(
        lambda d: metres(d.plan.placement),
        "centre of the hand's bounding box before its turn", "m", _XYZ,
    ),
    "rotation_rad": Label(
        lambda d: radians(d.plan.placement), "turns about x, then y, then z", "rad", _XYZ
    ),
    "alpha": Label(
        lambda d: list((d.plan.alpha or Alpha()).of_parts.values()),
        "0 specular to 1 diffuse", None, _PARTS, "alpha",
    ),
    "roughness_rms_m": Label(
        _of_parts(lambda m: m.roughness_rms_m),
        "RMS height of the roughness", "m", _PARTS, "material",
    ),
    "correlation_length_m": Label(
        _of_parts(lambda m: m.correlation_length_m),
        "of the roughness; NaN: smooth", "m", _PARTS, "material",
    ),
    "coating_thickness_m": Label(
        _of_parts(lambda m: None if m.coating is None else m.coating.thickness_m),
        "of the coating; NaN: none", "m", _PARTS, "material",
    ),
    "sequence": Label(
        lambda d: d.number, "number of the sequence of frames", of="movement", dtype="int64"
    ),
    "frame": Label(
        lambda d: d.frame, "number of the frame in its sequence", of="movement", dtype="int32"
    ),
    "time_s": Label(
        lambda d: d.start_s, "when the frame begins in its sequence", "s", of="movement"
    ),
    "recipe": Label(lambda d: _text(d.record), "all that the sample is made of, JSON"),
}  # fmt: skip
"""Labels of a sample; of those of the materials None is stored as NaN."""

MADE_WITH = "versions and device, JSON"
TEXTS = ("pose", "handedness", "rig", "recipe", "made_with")


def labels_of(plan: Plan) -> dict[str, Label]:
    """Return those of `LABELS` that the samples of a plan have."""
    return {n: own for n, own in LABELS.items() if own.of is None or getattr(plan, own.of)}


def label_values(samples: Sequence[SamplePlan]) -> dict[str, Any]:
    """Return the labels of samples: lists of text, or arrays."""
    found: dict[str, Any] = {}
    for name, label in labels_of(samples[0].plan).items():
        values = [label.value(sample) for sample in samples]
        found[name] = values if name in TEXTS else np.array(values, dtype=label.dtype)
    return found


def fields_of_products(products: Sequence[str]) -> list[str]:
    """Return the arrays of products: those with the product's name, or with it before a "_"."""
    return [name for name in FIELDS if name in products or name.partition("_")[0] in products]


def data_bytes(plan: Plan) -> int:
    """Return the size of a sample's arrays, except meshes."""
    sizes = {name: len(values) for name, (values, _) in axes_of(plan).items()}
    fields = [FIELDS[name] for name in fields_of_products(plan.output.products)]
    return sum(
        np.dtype(field.dtype).itemsize * prod(sizes[axis] for axis in field.axes)
        for field in fields
        if not field.ragged
    )


def axes_of(plan: Plan) -> dict[str, tuple[Any, str | None]]:
    """Return the coordinates of the axes that the samples of a plan share, with their units."""
    found: dict[str, tuple[Any, str | None]] = {
        "joint": (JOINT_NAMES, None),
        "coordinate": (("x", "y", "z"), None),
        "angle": (ANGLES, None),
        "part": (PART_NAMES, None),
        "shape_parameter": (SHAPE_COLUMNS, None),
    }
    if "capture" in plan.output.products:
        array, waveform = radar_of(plan)
        found["tx"] = (np.arange(array.n_tx, dtype=np.int32), None)
        found["rx"] = (np.arange(array.n_rx, dtype=np.int32), None)
        found["frequency_hz"] = (waveform.frequencies_hz, "Hz")
        found |= {"tx_m": (array.tx_m, "m"), "rx_m": (array.rx_m, "m")}
    if plan.keeps_images:
        found |= {name: (getattr(plan.image.grid, name), "m") for name in ("x_m", "y_m", "z_m")}
    return found


# Writing


@contextmanager
def new_shard(path: Path, plan: Plan, *, force: bool = True) -> Iterator[ShardWriter]:
    """Yield a writer of samples; the shard is put in its place when it is whole."""
    import h5py

    with (
        replacing(path, force=force) as temporary,
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
        self._samples: list[SamplePlan] = []
        self._made_with: list[str] = []
        self._first: dict[str, list[int]] = {}
        self._failed: list[Aside] = []
        file.attrs.update(
            NX_class="NXroot", default="entry", clradar_format=FORMAT, clradar_version=VERSION
        )
        self._group("entry", "NXentry")

    def fail(self, aside: Aside) -> None:
        """Note that a sample could not be made."""
        self._failed.append(aside)

    def add(self, sample: Sample, made_with: Mapping[str, Any]) -> None:
        """Write a sample, with its versions and device, JSON values."""
        # First, since HDF5 cannot close a file for which the disk is full.
        size_bytes = sum(array.nbytes for array in sample.arrays.values())
        free = self._path.with_name(f"{self._path.stem}-space.tmp")
        require_space(free, size_bytes + 2 * CHUNK_BYTES)
        drawn = read_recipe(sample.recipe)
        if not self._samples:
            self._begin(drawn, sample.arrays)
        self._samples.append(drawn)
        self._made_with.append(_text(made_with))
        for name, first in self._first.items():
            field, array = FIELDS[name], sample.arrays[name]
            rows, data = len(array) if field.ragged else 1, self._file[field.place]
            data.resize(first[-1] + rows, axis=0)
            data[first[-1] :] = array
            data.flush()  # as in `_array`
            first.append(first[-1] + rows)

    def _begin(self, sample: SamplePlan, arrays: Mapping[str, np.ndarray]) -> None:
        """Make the groups and the empty arrays of all samples, with their axes."""
        names = [name for name in FIELDS if name in arrays]
        shown = next((name for name in SHOWN_FIRST if name in names), names[0])
        self._file["entry"].attrs["default"] = FIELDS[shown].group
        self._group("entry/labels", "NXcollection")
        self._group("entry/axes", "NXcollection")
        for name, (values, units) in axes_of(sample.plan).items():
            self._array(f"entry/axes/{name}", _bytes(values), units, name)
        for name in names:
            field, array = FIELDS[name], arrays[name]
            group = f"entry/{field.group}"
            if group not in self._file:
                attributes: dict[str, Any] = {"signal": field.dataset, "title": field.long_name}
                if not field.ragged:
                    attributes["axes"] = ["sample", *field.axes]
                self._group(group, "NXdata").attrs.update(attributes)
                more = ("tx_m", "rx_m") if field.group == "capture" else ()
                for axis in (*field.axes, *more):
                    if axis in self._file["entry/axes"]:
                        self._file[group][axis] = self._file[f"entry/axes/{axis}"]
            shape = array.shape[1:] if field.ragged else array.shape
            chunks = (RAGGED_ROWS, *shape) if field.ragged else (1, *_chunk(shape, array.itemsize))
            made = self._file.create_dataset(
                field.place, shape=(0, *shape), maxshape=(None, *shape), dtype=array.dtype,
                chunks=chunks, **self._filters,
            )  # fmt: skip
            _describe(made, field.units, field.long_name)
            if field.axes[-2:] == _YX:
                made.attrs["interpretation"] = "image"
            self._first[name] = [0]

    def finish(self) -> None:
        """Write labels, where ragged arrays begin, and what failed."""
        if self._samples:
            index = np.array([one.sample for one in self._samples], dtype=np.int64)
            self._array("entry/labels/sample", index, None, "number of the sample in the plan")
            for name, value in label_values(self._samples).items():
                label = LABELS[name]
                made = self._array(
                    f"entry/labels/{name}", _bytes(value), label.units, label.long_name
                )
                if label.axes:
                    made.attrs["axes"] = ["sample", *label.axes]
            self._array("entry/labels/made_with", _bytes(self._made_with), None, MADE_WITH)
        for name, rows in self._first.items():
            field, first = FIELDS[name], np.array(rows, dtype=np.int64)
            if field.ragged:
                self._array(field.first_place, first, None, f"where {field.dataset} begin, and end")
            group = self._file[f"entry/{field.group}"]
            if "sample" not in group:
                group["sample"] = self._file["entry/labels/sample"]
        if self._failed:
            texts = [_text({n: getattr(one, n) for n in one.__slots__}) for one in self._failed]
            self._array(FAILED, _bytes(texts), None, "what failed, and why, JSON")

    def _group(self, name: str, kind: str) -> Any:
        group = self._file.create_group(name)
        group.attrs["NX_class"] = kind
        return group

    def _array(self, place: str, value: np.ndarray, units: str | None, long_name: str) -> Any:
        made = self._file.create_dataset(place, data=value, chunks=value.shape, **self._filters)
        _describe(made, units, long_name)
        made.flush()  # else its place in the file would depend on when Python closes it
        return made


def _describe(made: Any, units: str | None, long_name: str) -> None:
    # Viewers write one or the other; names of axes have their unit already.
    own = units is None or long_name.endswith(f"_{units}")
    made.attrs["long_name"] = long_name if own else f"{long_name} ({units})"
    if units is not None:
        made.attrs["units"] = units


def _chunk(shape: tuple[int, ...], item_bytes: int) -> tuple[int, ...]:
    """Return the shape of a chunk of one sample, about 1 MiB of whole planes."""
    if prod(shape) * item_bytes <= SMALL_BYTES:
        return shape
    plane_bytes = max(1, prod(shape[1:]) * item_bytes)
    return (min(shape[0], max(1, CHUNK_BYTES // plane_bytes)), *shape[1:])


def _text(value: Mapping[str, Any]) -> str:
    return json.dumps(value, allow_nan=False)


def _bytes(values: Any) -> np.ndarray:
    """Return numbers unchanged, texts as UTF-8 of a fixed length."""
    if isinstance(values, np.ndarray):
        return values
    import h5py

    encoded = [text.encode("utf-8") for text in values]
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, *map(len, encoded))))


# Reading


@contextmanager
def opened_shard(path: Path) -> Iterator[Any]:
    """Open a shard for reading, in this process.

    The HDF5 library is not safe against damaged files: what may be damaged is read by
    `read_confined`; ``clradar inspect DIR --check`` verifies a data set from elsewhere first.
    """
    import h5py

    regular_file_size(path, EXPECTED)
    with reading(path, EXPECTED), h5py.File(path, "r") as file:
        _check_format(path, file)
        yield file


def _check_format(path: Path, file: Any) -> None:
    if file.attrs.get("clradar_format") != FORMAT:
        fail(path, EXPECTED, "another HDF5 file")
    version = file.attrs.get("clradar_version")
    if version > VERSION:
        fail(path, f"version {VERSION} or older", f"{version}; update clradar")


def fields_of(file: Any) -> list[str]:
    """Return the names of `FIELDS` that a shard has."""
    return [name for name, f in FIELDS.items() if f.place in file]


def samples_of(file: Any) -> list[int]:
    """Return the numbers of the samples in an open shard."""
    place = "entry/labels/sample"
    return file[place][:].tolist() if place in file else []


def failed_of(file: Any) -> dict[int, Aside]:
    """Return the samples that failed, and why, by their numbers."""
    texts = file[FAILED][:] if FAILED in file else ()
    found = (Aside(**json.loads(text)) for text in texts)
    return {aside.sample: aside for aside in found}


def arrays_of(file: Any, row: int) -> dict[str, np.ndarray]:
    """Return the arrays of one sample of an open shard."""
    arrays = {}
    for name in fields_of(file):
        spec = FIELDS[name]
        dataset = file[spec.place]
        if spec.ragged:
            first = file[spec.first_place]
            arrays[name] = dataset[int(first[row]) : int(first[row + 1])]
        else:
            arrays[name] = dataset[row]
    return arrays


def sample_of(file: Any, row: int, plan: Plan) -> tuple[Sample, dict[str, Any]]:
    """Return one sample of an open shard, and the versions and the device that made it."""
    recipe, made_with = (file[f"entry/labels/{name}"][row] for name in ("recipe", "made_with"))
    return Sample(stored_recipe(recipe, plan), arrays_of(file, row)), json.loads(made_with)


def stored_recipe(text: str | bytes, plan: Plan) -> dict[str, Any]:
    """Return a recipe; of those of clradar 0.2, which had other keys, what the plan makes of it."""
    found = parse_object(text.decode() if isinstance(text, bytes) else text)
    return found if found["version"] == RECIPES else recipe_of(plan, found["sample"])


def row_of(file: Any, path: Path, sample: int) -> int:
    """Return the row of a sample in an open shard."""
    found = samples_of(file)
    if found.count(sample) != 1:
        fail(path, f"sample {sample} once", f"{found.count(sample)} times")
    return found.index(sample)


@contextmanager
def guarded_shard(path: Path) -> Iterator[Any]:
    """Open a shard that may be damaged or hostile: in a confined process, by `read_confined`."""
    with hdf5_guard.opened(path, EXPECTED) as file:
        _check_format(path, file)
        yield file


def read_confined(function: Callable[..., Any], path: Path, *arguments: Any, size: int) -> Any:
    """Call `function(path, *arguments)` in a confined process; it uses `guarded_shard`.

    Nothing of what it returns is believed; the expected bytes of arrays say what it may use.
    """
    return run(function, path, *arguments, most_bytes=size + 8 * path.stat().st_size)


def read_sample(path: Path, sample: int, plan: Plan) -> tuple[Sample, dict[str, Any]]:
    """Return a stored sample of a plan, and what made it."""
    found = read_confined(_sample, path, sample, size=data_bytes(plan))
    with reading(path, EXPECTED):
        recipe = stored_recipe(found["recipe"], plan)
        return Sample(recipe, found["arrays"]), parse_object(found["made_with"])


def _sample(path: Path, sample: int) -> dict[str, Any]:
    with guarded_shard(path) as file:
        row = row_of(file, path, sample)
        texts = {n: file[f"entry/labels/{n}"][row].decode() for n in ("recipe", "made_with")}
        return {**texts, "arrays": arrays_of(file, row)}

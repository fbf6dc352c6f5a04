"""The readers under trial and their allowed results. A new reader is one entry here."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path

import numpy as np

from clradar.arrays import read_clusters
from clradar.dataset.folder import Manifest, read_manifest
from clradar.dataset.plan.plan import PlanError
from clradar.errors import MeasurementError, MeshError, RigError
from clradar.hand import HandPose, read_pose
from clradar.model import Capture, ChannelCalibration, DepthMap, Scene, Volume
from clradar.model.material_file import read_materials
from clradar.motion.motion_file import Motion, read_motion
from clradar.rigs import Rig, read_rig
from fuzz import mutators, seeds
from measurement_io import (
    Description,
    Layout,
    SensorAlignment,
    check_file,
    describe,
    open_capture,
    open_channels,
    open_volume,
    read_alignment,
    read_depth_map,
    read_layout,
)
from measurement_io.maroon.frame import read_antenna_file

Mutator = Callable[[bytes, random.Random], bytes]
Seeds = Callable[[], list[bytes]]


@dataclass(frozen=True, slots=True, eq=False)
class Format:
    """What is known of a format: changes to its structure, its tokens, how it is made right again.

    `repair` is applied last to most inputs, so that mutants get past checksums.
    """

    structured: tuple[Mutator, ...] = ()
    tokens: tuple[bytes, ...] = ()
    repair: Callable[[bytes], bytes] | None = None


_HDF5 = Format((mutators.change_hdf5,), mutators.HDF5)
_ZIP = Format((), (b"'descr'", b"'<c8'", b"'|O'", b".npy"))
_JSON = Format((mutators.change_json,), mutators.JSON)
_PICKLE = Format((mutators.change_pickle,), mutators.PICKLE)
_PNG = Format((), (b"IHDR", b"IDAT", b"tRNS", b"zTXt"), mutators.png_checksums)
_GLB = Format((mutators.change_glb,), mutators.GLTF)
_GLTF = Format((mutators.change_json,), mutators.GLTF)


def _text(*tokens: bytes) -> Format:
    return Format((mutators.change_lines,), (*mutators.TEXT, *tokens))


def _toml(*tokens: bytes) -> Format:
    return _text(b"= 1e999", b"= -1", b"[[", b"{", b'"""', b"\\u0000", *tokens)


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """One reader under trial: where its file lies, seeds that give a `result`, and its limits.

    `around` returns what has to lie around the file, content by name; `error` is what reading may
    raise. `short_run` inputs are tried with all the tests. The limits are of one input, which has
    at most a megabyte.
    """

    file_name: str
    seeds: Seeds
    read: Callable[[Path], object]
    result: type
    format: Format = field(default_factory=Format)
    around: Callable[[], dict[str, bytes]] = dict
    error: type[Exception] = MeasurementError
    short_run: int = 40
    processor_limit_s: float = 10.0
    resident_limit_bytes: int = 10**9

    def place(self, folder: Path) -> Path:
        """Make what lies around the input and return where the input goes."""
        for name, content in {self.file_name: b"", **self.around()}.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return folder / self.file_name

    def mutated(self, seed: int, index: int) -> bytes:
        """Return input number `index` of the run `seed`: the same bytes every time.

        It is a valid file with one to a few changes, at times spliced with another one.
        """
        rng = random.Random(f"{self.file_name}/{seed}/{index}")
        others = _corpus(self)
        data = rng.choice(others)
        for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 5, 8))):
            if self.format.structured and rng.random() < 0.6:
                data = rng.choice(self.format.structured)(data, rng)
            else:
                data = mutators.change_bytes(data, rng, self.format.tokens, others)
        if self.format.repair is not None and rng.random() < 0.8:
            data = self.format.repair(data)
        return data


@cache
def _corpus(target: Target) -> tuple[bytes, ...]:
    return tuple(target.seeds())


def _files(*patterns: str) -> Seeds:
    return partial(seeds.files, *patterns)


def _and_check(opener: Callable[[Path], object], path: Path) -> object:
    found = opener(path)
    check_file(path)  # looks at more than opening does
    return found


def _native(name: str, opener: Callable[[Path], object], kind: type) -> Target:
    read = partial(_and_check, opener)
    return Target(f"{name}.h5", _files(f"{name}-*.h5"), read, kind, _HDF5)


def _with_layout(path: Path) -> object:
    describe(path)
    return open_capture(path, layout=path.with_name("lab.toml"))


def _lab(*names: str, form: Format = Format()) -> Target:
    (layout,) = seeds.files("lab.toml")
    around = partial(dict, {"lab.toml": layout})
    return Target("lab.bin", _files(*names), _with_layout, Capture, form, around)


def _mesh(ending: str, form: Format) -> Target:
    few = {"error": MeshError, "short_run": 20}
    return Target(f"mesh.{ending}", _files(f"mesh*.{ending}"), Scene.from_mesh, Scene, form, **few)


def _rig(name: str, rig_seeds: Seeds, form: Format) -> Target:
    read = partial(read_rig, handedness="right", unit="m")
    return Target(name, rig_seeds, read, Rig, form, error=RigError, short_run=15)


def _manifest(path: Path) -> object:
    try:
        return read_manifest(path.parent)
    except PlanError as error:  # has a line for each mistake, and each names the file
        worst = next((line for line in error.mistakes if path.name not in line), error.mistakes[0])
        raise MeasurementError(worst) from error


_DEPTH = "depth/000000.png"
_PRODUCTS = partial(seeds.radar_folder, "calibration.json", _DEPTH, "maxproj/000000.png")
_NO_FRAME = {f"{seeds.RADAR}/calibrated_data/000000.npy": b"which takes no time to read"}
_POSED = {"motion/bent.toml": _files("pose.toml")()[0]}

TARGETS = {
    "frame": Target("000000.npy", seeds.frames, open_capture, Capture, _PICKLE),
    "native_capture": _native("capture", open_capture, Capture),
    "native_volume": _native("volume", open_volume, Volume),
    "native_channels": _native("channels", open_channels, ChannelCalibration),
    "lab_npz": _lab("lab*.npz", form=_ZIP),
    "lab_hdf5": _lab("lab*.h5", "lab-7.3.mat", form=_HDF5),
    "lab_mat": _lab("lab-5*.mat"),
    "calibration_json": Target(
        f"{seeds.RADAR}/calibration.json",
        _files("calibration-*.json", f"recording/30/{seeds.RADAR}/calibration.json"),
        lambda path: describe(path.parent), Description, _JSON, lambda: _NO_FRAME,
    ),
    "alignment_json": Target(
        "alignment.json", _files("alignment-*.json"), read_alignment, SensorAlignment, _JSON
    ),
    "depth_png": Target(
        f"{seeds.RADAR}/{_DEPTH}", partial(list, seeds.radar_folder(_DEPTH).values()),
        lambda path: read_depth_map(path.parents[1], 0), DepthMap, _PNG, _PRODUCTS,
    ),
    "antennas": Target(
        "Rx.dat", _files("antennas-*.dat"), read_antenna_file, np.ndarray, _text()
    ),
    "mesh_obj": _mesh(
        "obj", _text(b"f 1 2 3\n", b"f 99999999999 1 2\n", b"v 0 0 0\n", b"mtllib ")
    ),
    "mesh_glb": _mesh("glb", _GLB),
    "mesh_gltf": _mesh("gltf", _GLTF),
    "mesh_ply": _mesh(
        "ply", _text(b"element vertex 99999999999", b"property list uchar int x", b"end_header")
    ),
    "mesh_stl": _mesh("stl", _text(b"facet normal", b"endsolid")),
    "mesh_off": _mesh("off", _text()),
    "rig_glb": _rig("hand.glb", seeds.rigs, _GLB),
    "mano_npz": _rig("model.npz", _files("model.npz"), _ZIP),
    "mano_pickle": _rig("model.pkl", seeds.hand_models, _PICKLE),
    "manifest": Target(
        "manifest.json", _files("data-set*/manifest.json"), _manifest, Manifest, _JSON
    ),
    "layout_toml": Target(
        "lab.toml", _files("lab.toml", "examples/layouts/*.toml"), read_layout, Layout,
        _toml(b"[data]", b"axes", b'"tx"'),
    ),
    "materials_toml": Target(
        "materials.toml", partial(seeds.of_page, "materials.md"), read_materials, dict,
        _toml(b"permittivity", b"poles", b"frequency_hz", b'"1-1j"'),
    ),
    "array_toml": Target(
        "array.toml", _files("array-*.toml"), read_clusters, tuple,
        _toml(b"n = 20000", b"[[pose]]", b"points_m", b"gain"),
    ),
    "pose_toml": Target(
        "pose.toml", _files("pose.toml"), read_pose, HandPose,
        _toml(b"_deg", b"joints"),
    ),
    "motion_toml": Target(
        "motion/motion.toml", partial(seeds.of_page, "movement.md"),
        read_motion, Motion, _toml(b"time_s", b"place", b"[[hand]]", b"mesh"), lambda: _POSED,
    ),
}  # fmt: skip

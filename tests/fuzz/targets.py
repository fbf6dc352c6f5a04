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
from clradar.motion.motion_file import read_motion
from clradar.motion.motion_record import Motion
from clradar.rigs import Rig, read_rig
from fuzz import mutators, seeds
from measurement_io import (
    Description,
    Layout,
    RecordingMetadata,
    SensorAlignment,
    check_file,
    describe,
    open_capture,
    open_channels,
    open_volume,
    open_with_layout,
    read_alignment,
    read_depth_map,
    read_layout,
    read_metadata,
)
from measurement_io.antenna_file import read_antenna_file

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


def _and_check(opener: Callable[[Path], object], path: Path) -> object:
    found = opener(path)
    check_file(path)  # looks at more than opening does
    return found


def _native(name: str, native_seeds: Seeds, opener: Callable[[Path], object], kind: type) -> Target:
    return Target(name, native_seeds, partial(_and_check, opener), kind, _HDF5)


def _with_layout(path: Path) -> object:
    describe(path)
    return open_with_layout(path, path.with_name("lab.toml"))


def _lab(*kinds: str, form: Format = Format()) -> Target:
    files = partial(seeds.containers, *kinds)
    around = partial(dict, {"lab.toml": seeds.LAYOUT})
    return Target("lab.bin", files, _with_layout, Capture, form, around)


def _mesh(ending: str, form: Format) -> Target:
    files = partial(seeds.named_meshes, ending)
    few = {"error": MeshError, "short_run": 20}
    return Target(f"mesh.{ending}", files, Scene.from_mesh, Scene, form, **few)


def _rig(name: str, rig_seeds: Seeds, form: Format) -> Target:
    read = partial(read_rig, handedness="right", unit="m")
    return Target(name, rig_seeds, read, Rig, form, error=RigError, short_run=15)


def _manifest(path: Path) -> object:
    try:
        return read_manifest(path.parent)
    except PlanError as error:  # has a line for each mistake, and each names the file
        worst = next((line for line in error.mistakes if path.name not in line), error.mistakes[0])
        raise MeasurementError(worst) from error


_DEPTH = f"{seeds.RADAR}/depth/000000.png"
_NO_FRAME = {f"{seeds.RADAR}/calibrated_data/000000.npy": b"which takes no time to read"}
_MANIFESTS = partial(seeds.frozen, "data-set/manifest.json", "data-set-stopped/manifest.json")
_POSED = {"motion/bent.toml": seeds.frozen("pose.toml")[0]}

TARGETS = {
    "frame": Target("000000.npy", seeds.frames, open_capture, Capture, _PICKLE),
    "native_capture": _native("capture.h5", seeds.native_captures, open_capture, Capture),
    "native_volume": _native("volume.h5", seeds.native_volumes, open_volume, Volume),
    "native_channels": _native(
        "channels.h5", lambda: seeds.in_both_forms(*seeds.frozen("channels-2.h5")), open_channels,
        ChannelCalibration,
    ),
    "lab_npz": _lab("npz", "npz deflated", form=_ZIP),
    "lab_hdf5": _lab("hdf5", "hdf5 gzip", "hdf5 lzf", "mat v7.3", form=_HDF5),
    "lab_mat": _lab("mat v5", "mat v5 deflated"),
    "calibration_json": Target(
        f"{seeds.RADAR}/calibration.json", seeds.calibrations, lambda path: describe(path.parent),
        Description, _JSON, lambda: _NO_FRAME,
    ),
    "alignment_json": Target(
        "alignment.json", seeds.alignments, read_alignment, SensorAlignment, _JSON
    ),
    "metadata_json": Target(
        "metadata.json", seeds.metadata, read_metadata, RecordingMetadata, _JSON
    ),
    "depth_png": Target(
        _DEPTH, lambda: [seeds.products()[_DEPTH]],
        lambda path: read_depth_map(path.parents[1], 0), DepthMap, _PNG, seeds.products,
    ),
    "antennas": Target("Rx.dat", seeds.antenna_files, read_antenna_file, np.ndarray, _text()),
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
    "mano_npz": _rig("model.npz", seeds.hand_archives, _ZIP),
    "mano_pickle": _rig("model.pkl", seeds.hand_models, _PICKLE),
    "manifest": Target("manifest.json", _MANIFESTS, _manifest, Manifest, _JSON),
    "layout_toml": Target(
        "lab.toml", seeds.layouts, read_layout, Layout, _toml(b"[data]", b"axes", b'"tx"')
    ),
    "materials_toml": Target(
        "materials.toml", lambda: [seeds.of_page("materials.md")], read_materials, dict,
        _toml(b"permittivity", b"poles", b"frequency_hz", b'"1-1j"'),
    ),
    "array_toml": Target(
        "array.toml", seeds.arrays, read_clusters, tuple,
        _toml(b"n = 20000", b"[[pose]]", b"points_m", b"gain_db"),
    ),
    "pose_toml": Target(
        "pose.toml", partial(seeds.frozen, "pose.toml"), read_pose, HandPose,
        _toml(b"_deg", b"joints"),
    ),
    "motion_toml": Target(
        "motion/motion.toml", lambda: [seeds.of_page("movement.md")],
        read_motion, Motion, _toml(b"time_s", b"place", b"[[hand]]", b"mesh"), lambda: _POSED,
    ),
}  # fmt: skip

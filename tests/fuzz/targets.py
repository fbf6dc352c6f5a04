"""The readers under trial and their allowed results. A new reader is one entry here."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from clradar.arrays import read_clusters
from clradar.dataset.folder import Manifest, read_manifest
from clradar.dataset.plan.plan import PlanError
from clradar.errors import MeasurementError, MeshError, RigError
from clradar.model import (
    Capture,
    ChannelCalibration,
    DepthMap,
    Scene,
    Volume,
)
from clradar.model.material_file import read_materials
from clradar.motion.motion_file import Motion, read_motion
from clradar.rigs import Rig, read_rig
from fuzz import (
    mutate_bytes,
    mutate_gltf,
    mutate_hdf5,
    mutate_json,
    mutate_pickle,
    mutate_png,
    mutate_text,
    mutate_zip,
    seeds,
)
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
from measurement_io.maroon.recording import placed_mesh

HDF5_SHORT_RUN = 40
"""Each input of HDF5 costs three processes: to open it, to check it, to describe it."""

MESH_SHORT_RUN = 30
"""Each mesh or rig costs a process."""

_PLY_TOKENS = (
    b"element vertex 99999999999", b"property list uchar int x", b"end_header", b"ascii",
)  # fmt: skip

Mutator = Callable[[bytes, random.Random], bytes]


@dataclass(frozen=True, slots=True)
class Target:
    """One reader under trial.

    Attributes
    ----------
    name : str
    seeds : callable
        Makes valid files, small ones, always the same. Reading each has to give a result.
    read : callable
        Reads the file at a path.
    results : tuple of type
        What reading may return.
    structured : tuple of callable
        Mutators that know the format: `(data, random) -> data`. Those of `mutate_bytes` apply too.
    dictionary : tuple of bytes
        Tokens of the format, for the byte mutators.
    file_name : str
        Where the file lies, relative to an empty folder; a reader may use its name.
    around : callable, optional
        Called once with that empty folder, to put there what has to lie around the file.
    repair : callable, optional
        Applied last to most inputs: makes checksums right again, so that mutants get past them.
    errors : tuple of type
        What reading may raise.
    processor_limit_s : float
        Most processor time for one input, which has at most a megabyte. Most take milliseconds.
    resident_limit_bytes : int
        Most memory that reading one input may add; half of what is promised.
    short_run : int
        Inputs that are tried with all the tests.
    any_format : bool
        Whether the content decides how the file is read: as HDF5, for which a process is started.
    """

    name: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], object]
    results: tuple[type, ...]
    structured: tuple[Mutator, ...] = ()
    dictionary: tuple[bytes, ...] = ()
    file_name: str = "input"
    around: Callable[[Path], None] | None = None
    repair: Callable[[bytes], bytes] | None = None
    errors: tuple[type[Exception], ...] = (MeasurementError,)
    processor_limit_s: float = 10.0
    resident_limit_bytes: int = 10**9
    short_run: int = 100
    any_format: bool = False

    def place(self, folder: Path) -> Path:
        """Make what lies around the input and return where the input goes."""
        path = folder / self.file_name
        path.parent.mkdir(parents=True, exist_ok=True)
        if self.around is not None:
            self.around(folder)
        return path

    def mutated(self, seed: int, index: int) -> bytes:
        """Return input number `index` of the run `seed`: the same bytes every time."""
        rng = random.Random(f"{self.name}/{seed}/{index}")
        return self.mutate(rng.choice(_corpus(self)), rng)

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        """Return `data` with one to a few changes, at times spliced with another seed."""
        others = _corpus(self)
        for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 5, 8))):
            if self.structured and rng.random() < 0.6:
                data = rng.choice(self.structured)(data, rng)
            else:
                data = mutate_bytes.mutate(data, rng, self.dictionary, others)
        if self.repair is not None and rng.random() < 0.8:
            data = self.repair(data)
        return data


@cache
def _corpus(target: Target) -> tuple[bytes, ...]:
    return tuple(target.seeds())


def _open_and_check(opener: Callable[[Path], object]) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        found = opener(path)
        check_file(path)  # looks at more than opening does
        return found

    return read


def _describe_folder(path: Path) -> object:
    return describe(path.parent)


def _product(read: Callable[[Path, int], object]) -> Callable[[Path], object]:
    return lambda path: read(path.parents[1], 0)


def _with_layout(path: Path) -> object:
    describe(path)
    return open_with_layout(path, path.with_name("lab.toml"))


def _placed_mesh(path: Path) -> object:
    return placed_mesh(path.parents[1], "mesh", read_alignment(path.parents[1] / "alignment.json"))


def _rig(path: Path) -> object:
    return read_rig(path, handedness="right", unit="m")


def _manifest(path: Path) -> object:
    try:
        return read_manifest(path.parent)
    except PlanError as error:  # has a line for each mistake, and each names the file
        worst = next((line for line in error.mistakes if path.name not in line), error.mistakes[0])
        raise MeasurementError(worst) from error


def _png(name: str, read: Callable[[Path, int], object], result: type) -> Target:
    file = f"{name}/000000.png"
    return Target(
        f"{name}_png",
        lambda: seeds.product(file),
        _product(read),
        (result,),
        (mutate_png.mutate_chunks,),
        mutate_png.DICTIONARY,
        file_name=f"radar_72.0_82.0_2/{file}",
        around=seeds.products_folder,
        repair=mutate_png.with_right_checksums,
    )


def _mesh(name: str, *structured: Mutator, dictionary: tuple[bytes, ...] = ()) -> Target:
    ending = name.removeprefix("mesh_")
    return Target(
        name,
        lambda: seeds.named_meshes(ending),
        Scene.from_mesh,
        (Scene,),
        structured,
        dictionary,
        file_name=f"mesh.{ending}",
        errors=(MeshError,),
        short_run=MESH_SHORT_RUN,
    )


def _lab(
    name: str,
    kinds: tuple[str, ...],
    structured: tuple[Mutator, ...] = (),
    dictionary: tuple[bytes, ...] = (),
    repair: Callable[[bytes], bytes] | None = None,
    short_run: int = 100,
) -> Target:
    return Target(
        name,
        lambda: seeds.containers(*kinds),
        _with_layout,
        (Capture,),
        structured,
        dictionary,
        file_name="lab.bin",
        around=seeds.layout_file,
        repair=repair,
        short_run=short_run,
        any_format=True,
    )


TARGETS = {
    target.name: target
    for target in (
        Target(
            "frame",
            seeds.frames,
            open_capture,
            (Capture,),
            (mutate_pickle.mutate_npy, mutate_pickle.mutate_operations),
            mutate_pickle.DICTIONARY,
            file_name="000000.npy",
            any_format=True,
        ),
        Target(
            "native_capture",
            seeds.native_captures,
            _open_and_check(open_capture),
            (Capture,),
            mutate_hdf5.MUTATORS,
            mutate_hdf5.DICTIONARY,
            file_name="capture.h5",
            repair=mutate_hdf5.with_right_checksums,
            short_run=HDF5_SHORT_RUN,
            any_format=True,
        ),
        Target(
            "native_volume",
            seeds.native_volumes,
            _open_and_check(open_volume),
            (Volume,),
            mutate_hdf5.MUTATORS,
            mutate_hdf5.DICTIONARY,
            file_name="volume.h5",
            repair=mutate_hdf5.with_right_checksums,
            short_run=HDF5_SHORT_RUN,
            any_format=True,
        ),
        Target(
            "calibration_json",
            seeds.calibrations,
            _describe_folder,
            (Description,),
            (mutate_json.mutate,),
            mutate_json.DICTIONARY,
            file_name="radar_72.0_82.0_2/calibration.json",
            around=seeds.radar_folder,
        ),
        Target(
            "antennas",
            seeds.antenna_files,
            read_antenna_file,
            (np.ndarray,),
            (mutate_text.mutate_lines,),
            mutate_text.DICTIONARY,
            file_name="Rx.dat",
        ),
        Target(
            "native_channels",
            seeds.native_channels,
            _open_and_check(open_channels),
            (ChannelCalibration,),
            mutate_hdf5.MUTATORS,
            mutate_hdf5.DICTIONARY,
            file_name="channels.h5",
            repair=mutate_hdf5.with_right_checksums,
            short_run=HDF5_SHORT_RUN,
            any_format=True,
        ),
        Target(
            "alignment_json",
            seeds.alignments,
            read_alignment,
            (SensorAlignment,),
            (mutate_json.mutate,),
            mutate_json.DICTIONARY,
            file_name="alignment.json",
        ),
        Target(
            "metadata_json",
            seeds.metadata,
            read_metadata,
            (RecordingMetadata,),
            (mutate_json.mutate,),
            mutate_json.DICTIONARY,
            file_name="metadata.json",
        ),
        _png("depth", read_depth_map, DepthMap),
        _lab(
            "lab_npz",
            ("npz", "npz deflated"),
            (mutate_zip.mutate_members,),
            mutate_zip.DICTIONARY,
        ),
        _lab(
            "lab_hdf5",
            ("hdf5", "hdf5 gzip", "hdf5 lzf", "mat v7.3"),
            mutate_hdf5.MUTATORS,
            mutate_hdf5.DICTIONARY,
            mutate_hdf5.with_right_checksums,
            HDF5_SHORT_RUN,
        ),
        _lab("lab_mat", ("mat v5", "mat v5 deflated")),
        Target(
            "mesh_obj",
            seeds.meshes,
            _placed_mesh,
            (Scene,),
            (mutate_text.mutate_lines,),
            (
                *mutate_text.DICTIONARY,
                b"f 1 2 3\n",
                b"f 99999999999 1 2\n",
                b"v 0 0 0\n",
                b"mtllib ",
            ),
            file_name="photogrammetry/mesh.obj",
            around=seeds.mesh_folder,
            short_run=MESH_SHORT_RUN,
        ),
        _mesh("mesh_glb", mutate_gltf.mutate_json_chunk, dictionary=mutate_gltf.DICTIONARY),
        _mesh("mesh_gltf", mutate_json.mutate, dictionary=mutate_gltf.DICTIONARY),
        _mesh("mesh_ply", mutate_text.mutate_lines, dictionary=_PLY_TOKENS),
        _mesh("mesh_stl", mutate_text.mutate_lines, dictionary=(b"facet normal", b"endsolid")),
        _mesh("mesh_off", mutate_text.mutate_lines, dictionary=mutate_text.DICTIONARY),
        Target(
            "rig_glb",
            seeds.rigs,
            _rig,
            (Rig,),
            (mutate_gltf.mutate_json_chunk,),
            mutate_gltf.DICTIONARY,
            file_name="hand.glb",
            errors=(RigError,),
            short_run=MESH_SHORT_RUN,
        ),
        Target(
            "mano_npz",
            seeds.hand_archives,
            _rig,
            (Rig,),
            (mutate_zip.mutate_members,),
            mutate_zip.DICTIONARY,
            file_name="model.npz",
            errors=(RigError,),
            short_run=MESH_SHORT_RUN,
        ),
        Target(
            "mano_pickle",
            seeds.hand_models,
            _rig,
            (Rig,),
            (mutate_pickle.mutate_operations,),
            mutate_pickle.DICTIONARY,
            file_name="model.pkl",
            errors=(RigError,),
            short_run=MESH_SHORT_RUN,
        ),
        Target(
            "manifest",
            seeds.manifests,
            _manifest,
            (Manifest,),
            (mutate_json.mutate,),
            mutate_json.DICTIONARY,
            file_name="manifest.json",
        ),
        Target(
            "layout_toml",
            seeds.layouts,
            read_layout,
            (Layout,),
            (mutate_text.mutate_lines,),
            (b"[data]", b"axes", b'"tx"', b"= 1e999", b"[[", b'"""', b"\\u0000", b"inf", b"nan"),
            file_name="lab.toml",
        ),
        Target(
            "materials_toml",
            seeds.materials,
            read_materials,
            (dict,),
            (mutate_text.mutate_lines,),
            (
                b"permittivity",
                b"poles",
                b"frequency_hz",
                b'"1-1j"',
                b"= 1e999",
                b"[[",
                b"nan",
                b"{",
            ),
            file_name="lab.toml",
        ),
        Target(
            "array_toml",
            seeds.arrays,
            read_clusters,
            (tuple,),
            (mutate_text.mutate_lines,),
            (b"n = 20000", b"[[pose]]", b"points_m", b"gain_db", b"= 1e999", b"= -1", b"nan", b"{"),
            file_name="array.toml",
        ),
        Target(
            "motion_toml",
            seeds.motions,
            read_motion,
            (Motion,),
            (mutate_text.mutate_lines,),
            (b"time_s", b"place", b"[[hand]]", b"mesh", b"= 1e999", b"= -1", b"nan", b"{", b"[["),
            file_name="motion/motion.toml",
            around=seeds.motion_folder,
        ),
        Target(
            "times_csv",
            seeds.times,
            lambda path: read_motion(path.with_name("motion.toml")),
            (Motion,),
            (mutate_text.mutate_lines,),
            mutate_text.DICTIONARY,
            file_name="times.csv",
            around=seeds.motion_of_times,
        ),
    )
}

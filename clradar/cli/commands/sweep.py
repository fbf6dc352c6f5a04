"""``clradar sweep``: find the alpha whose simulation is most like a measurement."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli import options as opt
from clradar.cli import sweeps
from clradar.cli.console import print_warning
from clradar.cli.inputs import Content, measurement
from clradar.cli.outputs import check_place_of_folder, provenance, settings_of
from clradar.files.failures import fail, read_bytes, reading
from clradar.files.hashing import sha256_of_arrays
from clradar.files.json_file import read_json
from clradar.files.json_text import parse_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from calibration import Regions

PARTS, FINGERS = "parts", "fingers"

LIMIT_BYTES = 2**28


@dataclass(frozen=True, kw_only=True)
class RegionOptions:
    """Regions of the mesh that have an alpha each."""

    regions: str | None = opt.option(
        "Find an alpha for each named part, for fingers and palm, or for the regions of a file: "
        ".npy or .json with a label per face, or .json with region: [parts].",
        metavar="parts|fingers|FILE",
    )
    joints: Path | None = opt.option(
        "For --regions fingers of a mesh without parts: joints as `clradar hand --joints` writes "
        "them, in the unit of the mesh.",
        metavar="JOINTS.json",
        needs=f"--regions={FINGERS}",
    )

    @property
    def files(self) -> list[Path]:
        """The file of regions, if there is one."""
        return [] if self.regions in (None, PARTS, FINGERS) else [Path(str(self.regions))]

    def read(self, scene: cl.Scene, unit: str) -> Regions | None:
        """The regions of a mesh as it is in its file, whose unit is that of the joints."""
        from calibration import Regions
        from clradar.model.plausible import MESH_UNITS_M

        if self.regions is None:
            return None
        if self.regions == PARTS:
            return Regions.of_parts(scene)
        if self.regions == FINGERS:
            joints = None if self.joints is None else MESH_UNITS_M[unit] * read_joints(self.joints)
            return Regions.of_fingers(scene, joints)
        return _read_regions(Path(self.regions), scene)


def command(
    *,
    measured: Path = opt.MEASURED,
    mesh: Path = opt.argument("Mesh file.", opt.REQUIRED, metavar="MESH"),
    output: Path = opt.output_option(
        "New folder, or one to resume.", opt.REQUIRED, metavar="DIR", folder=True
    ),
    alphas: sweeps.AlphaOptions,
    roughness: sweeps.RoughnessOptions,
    made_of: opt.MaterialOptions,
    regions: RegionOptions,
    place: opt.PlacementOptions,
    simulation: opt.SimulationOptions,
    radar: opt.RadarOptions,
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
) -> None:
    """Simulates MESH at every alpha with several seeds and compares each image with MEASURED. DIR
    gets sweep.png, sweep.csv, sweep.json and the settings. MESH is where --transform has it, as
    `clradar align --mesh` finds it. The same command resumes where a killed one stopped; other
    settings in the same DIR are refused, unless --force begins anew. Frequencies are those of
    MEASURED, where it is a capture. See docs/sweep.md.

    With --roughness-mm it estimates roughness and correlation length in millimetres, of a MESH
    of given --material, by the physical estimator.
    """
    from calibration.roughness.sweep import check_within_grid
    from clradar.compare import depth_map_of

    read = [mesh, *opt.files_of(place, regions, made_of)]
    check_place_of_folder(output, replaced=sweeps.OWN_NAMES, inputs=[measured, *read])
    if regions.regions is not None and simulation.max_bounces > 1:
        text = "expected 1 with --regions: a path of two bounces belongs to no single region"
        raise opt.wrong_usage("--max-bounces", text)
    kind = alphas if roughness.roughness_mm is None else roughness
    settings = simulation.settings(seed=alphas.seed, estimator=kind.estimator)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    scene = made_of.on(cl.Scene.from_mesh(mesh, unit=place.unit))
    labels, matrix = regions.read(scene, place.unit), place.matrix()
    found = measurement(measured, frames, radar, voxels, imaging, devices.first)
    own = found.content.meta.get("window", imaging.window)
    if own != imaging.window and isinstance(found.content, cl.Volume):
        print_warning(
            f"{measured}: was formed with the window '{own}'; simulations are with "
            f"'{imaging.window}' (--window)"
        )
    grid = opt.grid_text(found.volume.grid)
    origin = provenance([*found.files, *read], grid=grid)
    key = settings_of(
        origin, grid=grid, measured_sha256=digest(found.content), mesh_sha256=scene.digest(),
        regions=None if labels is None else list(labels.names),
        regions_sha256=None if labels is None else sha256_of_arrays(labels.face),
        transform=None if matrix is None else matrix.tolist(), frame=None, variant=None,
        radar_sha256=digest_of_radar(**found.radar),
        device=dict(devices.first.describe()), packages=origin["packages"],
    )  # fmt: skip
    range_db = depth.dynamic_range_db
    depth_map_of(found.volume, range_db, str(measured))  # raises before a folder is made
    placed = scene if matrix is None else scene.transformed(matrix)
    check_within_grid(placed, found.volume.grid)
    sweeps.sweep_into(
        output, kind, found, placed, origin, key, force=force, seeds=alphas.seeds, regions=labels,
        settings=settings, device=devices, dynamic_range_db=range_db, **imaging.arguments,
    )  # fmt: skip


def digest(image: Content) -> str:
    """The SHA-256 of everything in a capture or volume that a result depends on."""
    if isinstance(image, cl.Volume):
        return sha256_of_arrays(image.data, image.grid.x_m, image.grid.y_m, image.grid.z_m)
    radar = digest_of_radar(image.array, image.waveform)
    return sha256_of_arrays(image.data, np.frombuffer(radar.encode(), np.uint8))


def digest_of_radar(array: cl.AntennaArray, waveform: cl.Waveform) -> str:
    """The SHA-256 of the antennas' places and of the frequencies."""
    return sha256_of_arrays(array.tx_m, array.rx_m, waveform.frequencies_hz)


def _read_regions(path: Path, scene: cl.Scene) -> Regions:
    """A number or string for each face, or names of parts by region."""
    from calibration import Regions

    expected = "'parts', 'fingers', or a .npy or .json file with a label for each face"
    content = read_bytes(path, expected, LIMIT_BYTES)
    with reading(path, expected):
        if path.suffix.lower() == ".npy":
            labels: Any = np.load(path, allow_pickle=False)
            if labels.dtype.kind not in "iu":
                fail(path, "whole numbers", f"{labels.dtype}")
        else:
            labels = parse_json(content.decode("utf-8-sig"))
        if isinstance(labels, dict):
            if not all(_all_are(names, str) for names in labels.values()):
                fail(path, "lists of names of parts", "something else")
            return Regions.of_parts(scene, labels)
        if isinstance(labels, list) and not (_all_are(labels, int) or _all_are(labels, str)):
            fail(path, "a list of whole numbers or of strings", "something else")
        if np.shape(labels) != (scene.n_faces,):
            fail(path, f"{scene.n_faces} labels, one per face", f"shape {np.shape(labels)}")
        return Regions.of_labels(labels)


def _all_are(values: Any, kind: type) -> bool:
    return isinstance(values, list) and all(type(value) is kind for value in values)


def read_joints(path: Path) -> np.ndarray:
    """The joints of a JSON object name -> [x, y, z], shape (25, 3), in the file's unit."""
    from clradar.hand import JOINT_NAMES

    expected = "a JSON object with [x, y, z] of each of the 25 joints of a hand"
    value = read_json(path, expected, MAX_SMALL_JSON_BYTES)
    with reading(path, expected):
        missing = [name for name in JOINT_NAMES if name not in value]
        if missing:
            fail(path, expected, f"none of {missing[0]} and {len(missing) - 1} more")
        joints = np.array([value[name] for name in JOINT_NAMES], dtype=np.float64)
        if joints.shape != (len(JOINT_NAMES), 3) or not np.isfinite(joints).all():
            fail(path, expected, f"numbers of shape {joints.shape}, or not finite")
        return joints

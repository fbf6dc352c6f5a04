"""The images that `metric_evidence.py` compares: hands moved, of other alphas and seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hand_poses import poses
from scipy.spatial.transform import Rotation

import clradar
from clradar.files.atomic import replacing
from clradar.hand import hand_mesh
from clradar.hand.mesh import DEFAULT_CENTER_M

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)
SNR_DB = 20.0
VOXEL_M = 1e-3
SHIFTS_MM = (1, 2, 5)
LOWEST_CUT_DB = 30.0
"""Depths are kept down to here, so that the metrics can be tried at other dynamic ranges."""

# The paper's volume, and 5 voxels more on every side: a shift of whole voxels is another window.
MARGIN = max(SHIFTS_MM)
PAPER_M = ((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34))
GRID = clradar.VoxelGrid.from_extent(
    *((low - MARGIN * VOXEL_M, high + MARGIN * VOXEL_M) for low, high in PAPER_M), VOXEL_M
)


@dataclass(frozen=True, slots=True)
class Hand:
    """A pose, turned about the vertical through the middle of the hand.

    Facing the radar, the palm is a mirror whose glint outshines the rest; turned by 25 degrees it
    glints past the aperture (`clradar.cli.demonstration.DemoSettings.turn_deg`).
    """

    pose: str
    turn_deg: float

    @property
    def name(self) -> str:
        return f"{self.pose}, {'turned' if self.turn_deg else 'facing'}"


HANDS = (Hand("F", 25.0), Hand("flat", 25.0), Hand("two", 0.0), Hand("claw", 0.0))


@dataclass(frozen=True, slots=True)
class Shot:
    """One capture: `shift_mm` moves the mesh before it is simulated, of `rays` per sample."""

    hand: Hand
    alpha: float
    seed: int
    shift_mm: tuple[int, int, int] = (0, 0, 0)
    noisy: bool = False
    rays: int = 4

    @property
    def file_name(self) -> str:
        shift = "".join(f"{v:+d}" for v in self.shift_mm)
        kind = "measured" if self.noisy else "simulated"
        return (
            f"{self.hand.pose}{self.hand.turn_deg:g}_alpha{self.alpha:g}_seed{self.seed}"
            f"_rays{self.rays}_shift{shift}_{kind}.npz"
        )


def scene(hand: Hand) -> clradar.Scene:
    place = np.eye(4)
    turn = Rotation.from_euler("y", hand.turn_deg, degrees=True).as_matrix()
    centre_m = np.asarray(DEFAULT_CENTER_M)
    place[:3, :3], place[:3, 3] = turn, centre_m - turn @ centre_m
    return clradar.Scene.from_mesh(hand_mesh(poses()[hand.pose]), transform=place)


def volume(shot: Shot, device: clradar.Device) -> clradar.Volume:
    """Simulate 10 samples per mm2, which is the default, and form the image on GRID."""
    moved = np.eye(4)
    moved[:3, 3] = 1e-3 * np.array(shot.shift_mm)
    placed = scene(shot.hand).transformed(moved).with_alpha(shot.alpha)
    capture = clradar.simulate(
        placed, ARRAY, WAVEFORM, rays_per_sample=shot.rays, seed=shot.seed, device=device
    )
    if shot.noisy:
        capture = clradar.impair(capture, snr_db=SNR_DB, seed=shot.seed)
    return clradar.backproject(capture, GRID, device=device)


def window(image: clradar.Volume, shift_mm: tuple[int, int, int] = (0, 0, 0)) -> clradar.Volume:
    """Return the paper's volume with everything in it moved by whole voxels."""
    first = [MARGIN - s for s in shift_mm]
    x, y, z = (slice(f, n - 2 * MARGIN + f) for f, n in zip(first, GRID.counts, strict=True))
    grid = clradar.VoxelGrid.from_extent(*PAPER_M, VOXEL_M)
    return clradar.Volume(image.data[z, y, x], grid)


def along(axis: str, distance_mm: int) -> tuple[int, int, int]:
    """Return a shift along x, y or z."""
    x, y, z = (distance_mm if name == axis else 0 for name in "xyz")
    return x, y, z


def window_shifts() -> Iterator[tuple[int, int, int]]:
    yield (0, 0, 0)
    for axis in "xyz":
        for distance_mm in SHIFTS_MM:
            yield along(axis, distance_mm)


class Store:
    """Depth maps in a folder; what is not there yet is simulated."""

    def __init__(self, folder: Path, device: clradar.Device) -> None:
        self.folder, self.device = folder, device

    def has(self, shot: Shot) -> bool:
        return (self.folder / shot.file_name).exists()

    def make(self, shot: Shot) -> None:
        """Simulate a capture; keep its depth map, and those of its shifted windows."""
        image = volume(shot, self.device)
        still = shot.noisy or any(shot.shift_mm) or shot.rays != 4
        maps = {}
        for shift_mm in [(0, 0, 0)] if still else window_shifts():
            depth = window(image, shift_mm).depth_map(LOWEST_CUT_DB)
            name = "".join(f"{v:+d}" for v in shift_mm)
            maps[f"depth{name}"], maps[f"amplitude{name}"] = depth.depth_m, depth.amplitude
        with replacing(self.folder / shot.file_name, force=True) as path, path.open("wb") as file:
            np.savez_compressed(file, **maps)

    def image(self, shot: Shot, shift_mm: tuple[int, int, int] = (0, 0, 0)) -> clradar.DepthMap:
        """Return the depth map of a capture, its content moved by whole voxels."""
        name = "".join(f"{v:+d}" for v in shift_mm)
        grid = clradar.VoxelGrid.from_extent(*PAPER_M, VOXEL_M)
        with np.load(self.folder / shot.file_name) as stored:
            depth_m, amplitude = stored[f"depth{name}"], stored[f"amplitude{name}"]
        return clradar.DepthMap(depth_m, amplitude, grid.x_m, grid.y_m, LOWEST_CUT_DB)

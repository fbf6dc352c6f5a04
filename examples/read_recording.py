"""Go through a recording frame by frame, beside the mesh that belongs to it."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh

import clradar
from clradar.measurement_io import describe, open_recording, save_recording

GRID = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.04, 0.04), (0.27, 0.33), 2e-3)


def write_recording(folder: Path) -> None:
    """Write a recording where there is none: three noisy frames of a ball, and the ball's mesh."""
    # The mesh has its own origin; in the recording's radar space, whose x points to the right as
    # the radar sees it, the ball's centre is at x = -20 mm.
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.01)
    to_radar = trimesh.transformations.translation_matrix([-0.02, -0.01, 0.3])
    scene = clradar.Scene.from_mesh(ball, alpha=0.0, transform=np.diag([-1, 1, 1, 1]) @ to_radar)
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 32)
    still = clradar.simulate(scene, array, waveform, samples_per_mm2=20)
    rng = np.random.default_rng(0)
    frames = []
    for number in range(3):
        noise = 0.1 * (rng.standard_normal((*still.data.shape, 2)) @ [1, 1j])
        stamp = {"timestamp_us": 125_000 * (number + 1)}
        frames.append(clradar.Capture(still.data + noise, array, waveform, stamp))
    with TemporaryDirectory() as place:
        ball.export(f"{place}/mesh.obj", include_texture=False)
        save_recording(
            folder,
            frames,
            metadata={"distance_meters": 0.3},
            alignment={"photogrammetry2radar": to_radar.tolist()},
            meshes=[f"{place}/mesh.obj"],
        )


def main(source: str = "ball/30") -> None:
    if not Path(source).exists():
        write_recording(Path(source))
    print(describe(source), file=sys.stderr)
    recording = open_recording(source)
    mesh = recording.scene()  # in the antenna frame, as everything below
    centre_mm = 1e3 * (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0)) / 2
    print("mesh: centre at " + ", ".join(f"{v:.1f}" for v in centre_mm) + " mm")
    for capture in recording:  # one frame in memory at a time
        image = clradar.backproject(capture, GRID)
        z, y, x = np.unravel_index(np.abs(image.data).argmax(), image.data.shape)
        place_mm = [1e3 * axis[i] for axis, i in ((GRID.x_m, x), (GRID.y_m, y), (GRID.z_m, z))]
        at = ", ".join(f"{v:.0f}" for v in place_mm)
        print(f"frame {capture.meta['frame']}: {at} mm, {capture.meta['timestamp_us']} us")


if __name__ == "__main__":
    main()

"""Read a recorded frame of the 94 x 94 imager, keep it as a native file, and form its image."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import clradar
from clradar.measurement_io import describe, open_capture, save_capture, save_maroon_frame
from clradar.plot import image_figure, save_figure


def write_recording(folder: Path) -> None:
    """Write a frame to read where there is none: a small metal ball, and some noise."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.01)
    ball.apply_translation([0.02, -0.01, 0.3])
    scene = clradar.Scene.from_mesh(ball, alpha=0.0)
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 128)
    capture = clradar.simulate(scene, array, waveform, samples_per_mm2=20)
    rng = np.random.default_rng(0)
    noise = 0.1 * (rng.standard_normal((*capture.data.shape, 2)) @ [1, 1j])
    save_maroon_frame(folder, clradar.Capture(capture.data + noise, array, waveform))


def main(source: str = "ball/300mm", frame: int = 0) -> None:
    # A .npy frame, a radar_... folder, or the folder that holds it.
    if not Path(source).exists():
        Path(source).parent.mkdir(parents=True, exist_ok=True)
        write_recording(Path(source))
    print(describe(source))
    capture = open_capture(source, frame=frame)
    save_capture("frame.h5", capture, force=True)

    grid = clradar.VoxelGrid.from_extent((-0.05, 0.05), (-0.05, 0.05), (0.27, 0.33), 2e-3)
    volume = clradar.backproject(capture, grid)
    z, y, x = np.unravel_index(np.abs(volume.data).argmax(), volume.data.shape)
    place_mm = [1e3 * axis[i] for axis, i in ((grid.x_m, x), (grid.y_m, y), (grid.z_m, z))]
    print("strongest: " + ", ".join(f"{value:.0f}" for value in place_mm) + " mm")
    save_figure(image_figure(volume, "Frame 0"), "frame.png", force=True)


if __name__ == "__main__":
    main()

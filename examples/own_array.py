"""Another radar: a cross of 24 x 24 antennas at 24 to 26 GHz, and two metal balls."""

from __future__ import annotations

import numpy as np
import trimesh

import clradar


def cross(n: int = 24, spacing_m: float = 6e-3) -> clradar.AntennaArray:
    """Tx along y and Rx along x, centred, in the plane z = 0."""
    line_m = (np.arange(n) - (n - 1) / 2) * spacing_m
    zero = np.zeros(n)
    return clradar.AntennaArray(
        tx_m=np.stack([zero, line_m, zero], axis=1),
        rx_m=np.stack([line_m, zero, zero], axis=1),
        name="cross",
    )


def main(samples_per_mm2: float = 10.0) -> None:
    balls = []
    for centre_m in ((-0.10, 0.05, 0.45), (0.12, -0.04, 0.55)):
        ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
        balls.append(clradar.Scene.from_mesh(ball.apply_translation(centre_m), alpha=0.0))
    scene = clradar.Scene.combine(balls)
    # Steps need not be equal; 10 mm is a smaller fraction of this wavelength than of the default's.
    waveform = clradar.Waveform(np.linspace(24e9, 26e9, 41))
    capture = clradar.simulate(scene, cross(), waveform, samples_per_mm2=samples_per_mm2)
    grid = clradar.VoxelGrid.from_extent((-0.2, 0.2), (-0.15, 0.15), (0.35, 0.65), 5e-3)
    amplitude = np.abs(clradar.backproject(capture, grid, window="hann").data)
    for name, half in (("left", grid.x_m < 0), ("right", grid.x_m >= 0)):
        part = np.where(half, amplitude, 0.0)
        z, y, x = np.unravel_index(part.argmax(), part.shape)
        place_mm = 1e3 * np.array([grid.x_m[x], grid.y_m[y], grid.z_m[z]])
        print(f"{name}: " + ", ".join(f"{value:.0f}" for value in place_mm) + " mm")


if __name__ == "__main__":
    main()

"""
An array of your own
====================

Another radar than the one that comes along: place the antennas, choose the frequencies.
"""

# %%
# The antennas
# ------------
# Positions are metres, one row of x, y, z for each antenna. Here: a cross of 24 transmitters
# along y and 24 receivers along x, 6 mm apart.

import numpy as np
import trimesh

import clradar
from clradar.plot import image_figure, save_figure

line_m = (np.arange(24) - 11.5) * 6e-3
zero = np.zeros(24)
array = clradar.AntennaArray(
    tx_m=np.stack([zero, line_m, zero], axis=1),
    rx_m=np.stack([line_m, zero, zero], axis=1),
    name="cross",
)

# %%
# The frequencies
# ---------------
# 24 to 26 GHz in 41 steps; they need not be equal. What that resolves:

waveform = clradar.Waveform(np.linspace(24e9, 26e9, 41))
print(f"in depth: c / 2B = {1e3 * waveform.range_resolution_m:.0f} mm")
print(f"without ambiguity up to c / 2 df = {waveform.unambiguous_range_m:.1f} m")

# %%
# Two metal balls
# ---------------
# Any mesh does. Several scenes become one by ``combine``.

balls = []
for centre_m in ((-0.10, 0.05, 0.45), (0.12, -0.04, 0.55)):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    balls.append(clradar.Scene.from_mesh(ball.apply_translation(centre_m), alpha=0.0))
scene = clradar.Scene.combine(balls)
capture = clradar.simulate(scene, array, waveform, samples_per_mm2=4)

# %%
# The image
# ---------
# A window over frequency lowers side lobes for some resolution.

grid = clradar.VoxelGrid.from_extent((-0.2, 0.2), (-0.15, 0.15), (0.35, 0.65), spacing_m=5e-3)
volume = clradar.backproject(capture, grid, window="hann")
amplitude = np.abs(volume.data)
for name, half in (("left", grid.x_m < 0), ("right", grid.x_m >= 0)):
    z, y, x = np.unravel_index(np.where(half, amplitude, 0).argmax(), grid.shape)
    place_mm = 1e3 * np.array([grid.x_m[x], grid.y_m[y], grid.z_m[z]])
    print(f"{name}: " + ", ".join(f"{value:.0f}" for value in place_mm) + " mm")
figure = image_figure(volume, "Two balls, 24 to 26 GHz")
save_figure(figure, "own_array.png", force=True)

# %%
# The balls glint where they face the array, before their centres. Files of your own radar are
# read with a layout (:doc:`/tutorials/2_recording_to_image`), its channels calibrated with a
# plate (:doc:`/tutorials/5_channel_calibration`).

"""
A radar that is not the imager
==============================

What an array resolves and confuses before anything is built, and what the program says when a
scene meets it: 12 transmitters and 16 receivers at 60 GHz, a wavelength apart.
"""

# %%
# The array as a file
# -------------------
# ``clradar array cross60.toml --band 60:64:64`` prints and draws what follows, and every command
# that simulates takes ``--array cross60.toml``.

import warnings
from pathlib import Path

import numpy as np

import clradar
from clradar.plot import array_figure, image_figure, save_figure

Path("cross60.toml").write_text("""
[[tx]]
line = { first_m = [-0.0275, 0, 0], last_m = [0.0275, 0, 0], n = 12 }
[[rx]]
line = { first_m = [0, -0.0375, 0], last_m = [0, 0.0375, 0], n = 16 }
""")
array = clradar.arrays.read_array("cross60.toml")
waveform = clradar.Waveform.sfcw(60e9, 64e9, 64)

# %%
# What it resolves and confuses
# -----------------------------
# The sine of a grating lobe's angle is the wavelength over the spacing: 4.8 mm over 5 mm.

found = clradar.arrays.array_figures(array, waveform, (0, 0, 1.0))
across = ", ".join(f"{1e3 * width:.0f}" for width in found.widths_m)
print(f"widths along x, y, z: {across} mm")
print(f"unambiguous to {found.unambiguous_range_m:.2f} m")
lobe = found.lobes[0]
print(f"strongest lobe at {abs(lobe.azimuth_deg):.0f} degrees: {lobe.level_db:.1f} dB")
figure = array_figure(array, waveform, found)
save_figure(figure, "cross60.png", force=True)

# %%
# An echo that appears twice
# --------------------------
# A point at 1 m, in a grid so wide that a lobe is in it: the program says so.

capture = clradar.room_capture(array, waveform, [], points_m=[[0, 0, 1.0]])
wide = clradar.VoxelGrid.from_extent((-1.1, 1.1), (-0.1, 0.1), (0.2, 1.1), spacing_m=0.02)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always", clradar.ClradarWarning)
    clradar.backproject(capture, wide)
for message in said:
    print(message.message)

# %%
# A far target in a near grid
# ---------------------------
# At 5 m it is beyond two unambiguous ranges, and folds to 0.3 m.

far = clradar.room_capture(array, waveform, [], points_m=[[0, 0, 5.0]])
near = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.2, 0.4), spacing_m=0.01)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always", clradar.ClradarWarning)
    clradar.backproject(far, near)
for message in said:
    print(message.message)

# %%
# The image
# ---------
# Without a grid of your own ``place_grid`` finds one around the echo.

grid = clradar.place_grid(capture)
volume = clradar.backproject(capture, grid, window="hann")
z, y, x = np.unravel_index(np.abs(volume.data).argmax(), grid.shape)
print(f"found at {grid.x_m[x]:.2f}, {grid.y_m[y]:.2f}, {grid.z_m[z]:.2f} m")
figure = image_figure(volume, "A point at 1 m, 60 to 64 GHz", view="xz")
save_figure(figure, "other_radar.png", force=True)

# %%
# Half of the spacing has no lobe, for twice the antennas; antennas with a narrow pattern
# (``[tx_pattern]`` of the file) leave the lobes dark.

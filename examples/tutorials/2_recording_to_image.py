"""
A recording to an image
=======================

A file that another program wrote: say once what is in it, check it, form its image.
"""

# %%
# A file
# ------
# So that there is a file, the first lines play the other program: a network analyser behind
# switches, 24 transmitters and 20 receivers, which records a small ball at x = 20, y = -10, z =
# 250 mm into ``lab.npz``, in millimetres and gigahertz. Skip them if you have a file of your own.

from pathlib import Path

import numpy as np

import calibration
import clradar
import measurement_io
from clradar.plot import image_figure, save_figure

line = np.linspace(-70, 70, 24)
tx_mm = np.stack([np.full(24, -72.0), line, np.zeros(24)], axis=1)
rx_mm = np.stack([line[2:-2], np.full(20, 72.0), np.zeros(20)], axis=1)
f_ghz = np.linspace(72, 82, 64)
ball_mm = np.array([20.0, -10.0, 250.0])
to_tx, to_rx = (np.linalg.norm(side - ball_mm, axis=1) for side in (tx_mm, rx_mm))
path_m = (to_tx[:, None] + to_rx) / 1e3
samples = np.exp(-2j * np.pi * 1e9 * f_ghz[:, None, None] * path_m / 299_792_458)
samples += 0.3 * (np.random.default_rng(0).standard_normal((*samples.shape, 2)) @ [1, 1j])
parts = {"s_real": samples.real, "s_imag": samples.imag}
np.savez("lab.npz", f_ghz=f_ghz, tx_mm=tx_mm, rx_mm=rx_mm, **parts)

# %%
# What is in it
# -------------
# Opened as it is, the file is refused: nothing says which axis is which. Its description has the
# keys, and a template of the answer, a *layout*.

print(measurement_io.describe("lab.npz"))

# %%
# A layout is written once for a program, and then read with every file of it. :doc:`/layouts` has
# all settings.

Path("lab.toml").write_text("""
data = { real = "s_real", imag = "s_imag", axes = ["freq", "tx", "rx"] }
tx.key = "tx_mm"
rx.key = "rx_mm"
antennas.unit = "mm"
frequency = { key = "f_ghz", unit = "GHz" }
""")
capture = measurement_io.open_capture("lab.npz", layout="lab.toml")
print(capture.array.n_tx, "x", capture.array.n_rx, "antennas,", capture.waveform.n_freq, "steps")

# %%
# Is it right?
# ------------
# A wrong sign of the phase or swapped axes give no error, only a bad image, or a sharp one of the
# mirrored scene. ``diagnose`` images the capture under every hypothesis (:doc:`/diagnose`).
# Mirror images are equally sharp with these antennas, so we say where the ball was, too.

found = calibration.diagnose(capture, expected_m=ball_mm / 1e3)
print(found.recommendation)

# %%
# Keep it
# -------
# From here on the capture is like any other. The native file is read without a layout, by every
# command, too.

measurement_io.save_capture("lab.h5", capture, force=True)

# %%
# The image
# ---------
# Where in front of the radar is something? ``place_grid`` looks for it.

grid = clradar.place_grid(capture)
volume = clradar.backproject(capture, grid)
z, y, x = np.unravel_index(np.abs(volume.data).argmax(), grid.shape)
place_mm = 1e3 * np.array([grid.x_m[x], grid.y_m[y], grid.z_m[z]])
print("strongest: " + ", ".join(f"{value:.0f}" for value in place_mm) + " mm")
figure = image_figure(volume, "lab.npz")
save_figure(figure, "recording.png", force=True)

# %%
# x increases to the left, as the radar sees it. Next: :doc:`a recording of the MAROON data set
# </tutorials/3_maroon_recording>`, which is read without a layout.

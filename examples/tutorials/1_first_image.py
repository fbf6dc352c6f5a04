"""
First image
===========

A hand in front of a radar: simulate what the radar records, and form the image. You need nothing
but the package: ``pip install .`` in a clone, or ``make demo``, which makes ``.venv``.
"""

# %%
# The scene
# ---------
# What reflects is a triangle mesh, in metres. The radar looks along z from the origin, x and y
# span its aperture (:doc:`/conventions`). Here the mesh is a hand that shows the letter F, 30 cm
# away; ``clradar.Scene.from_mesh("hand.ply")`` takes a file instead. ``alpha`` says how rough the
# surface is, from 0, a mirror, to 1, chalk.

import clradar
from clradar.hand import hand_mesh
from clradar.plot import image_figure, save_figure

scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=0.3)
print(scene.n_faces, "faces")

# %%
# The radar
# ---------
# 94 transmitters and 94 receivers around a square of 14 cm. Each pair measures amplitude and
# phase at 64 frequencies from 72 to 82 GHz: more bandwidth resolves more in depth, more steps
# reach farther.

array = clradar.arrays.qar50()
waveform = clradar.Waveform.sfcw(72e9, 82e9, 64)

# %%
# The capture
# -----------
# One complex number for every transmitter, receiver and frequency.

capture = clradar.simulate(scene, array, waveform, seed=0)
print(capture.data.shape, capture.data.dtype)

# %%
# The image
# ---------
# Back-projection asks of every voxel how well the capture fits an echo from there. The grid spans
# the hand in steps of 2 mm; with 1 mm it would be sharper, and eight times the voxels.

grid = clradar.VoxelGrid.from_extent((-0.09, 0.09), (-0.11, 0.11), (0.26, 0.34), spacing_m=2e-3)
volume = clradar.backproject(capture, grid)

# %%
# The picture
# -----------
# Of a volume one looks at the maximum along the line of sight, and at the depth where it lies.
# What is more than 15 dB below the brightest point is left out.

depth = volume.depth_map(dynamic_range_db=15)
points_mm = 1e3 * depth.points_m()
print(f"{len(points_mm)} pixels, {points_mm[:, 2].mean():.0f} mm away on average")
figure = image_figure(depth, "Letter F, alpha = 0.3")
save_figure(figure, "first_image.png", force=True)

# %%
# Next: :doc:`a recording instead of the simulation </tutorials/2_recording_to_image>`. On the
# command line the same is ``clradar hand F -o hand.ply``, ``clradar simulate hand.ply -o sim.h5
# --alpha 0.3`` and ``clradar image sim.h5 -o volume.h5 --png image.png`` (:doc:`/command-line`).

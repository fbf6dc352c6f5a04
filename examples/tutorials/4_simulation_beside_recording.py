"""
Simulation beside a recording
=============================

A measured hand and its mesh, which is not quite where the hand was: find the pose, simulate it
there, and see what is left.
"""

# %%
# A measurement
# -------------
# It stands for a recording of yours, ``measurement_io.open_capture("hand/30", frame=0)``: a hand,
# with noise of a hundredth of its power. Every second antenna is enough here, and a quarter of
# the work.

import trimesh

import calibration
import clradar
from clradar.hand import hand_mesh
from clradar.plot import comparison_figure, save_figure

hand = clradar.Scene.from_mesh(hand_mesh("F", edge_length_m=3e-3), alpha=0.2)
imager = clradar.arrays.qar50()
array = clradar.AntennaArray(imager.tx_m[::2], imager.rx_m[::2])
radar = {"array": array, "waveform": clradar.Waveform.sfcw(72e9, 82e9, 48)}
clean = clradar.simulate(hand, **radar, seed=1)
recorded = clradar.impair(clean, snr_db=20, seed=1)

# %%
# The mesh
# --------
# What a scanner gives of the same hand lies 4 mm to the side and 3 mm too high here.

mesh = hand.transformed(trimesh.transformations.translation_matrix([4e-3, 3e-3, 0]))

# %%
# Both as images
# --------------
# The same grid for both, so that they can be compared voxel by voxel.

grid = clradar.VoxelGrid.from_extent((-0.08, 0.08), (-0.1, 0.1), (0.27, 0.33), spacing_m=2.5e-3)
measured = clradar.backproject(recorded, grid)
as_given = clradar.backproject(clradar.simulate(mesh, **radar), grid)

# %%
# The pose
# --------
# ``align_mesh`` moves the mesh until its visible surface fits the measured depths. It says how
# certain that is, and which motions the image does not tell (:doc:`/calibration`). Without
# ``correct_bias=False`` it is more exact: it simulates the mesh in its new place to see what
# highlights only pretend, for twice the time.

found = calibration.align_mesh(measured, mesh, correct_bias=False, **radar)
print(found.report())
placed = mesh.transformed(found.transform)
registered = clradar.backproject(clradar.simulate(placed, **radar), grid)

# %%
# Side by side
# ------------
# The overlap is 1 for the same depth map (:doc:`/metrics`).

simulated = [("as given", as_given), ("registered", registered)]
metrics = [clradar.compare(measured, image) for _, image in simulated]
for (label, _), agreement in zip(simulated, metrics, strict=True):
    print(f"{label}: overlap {agreement.overlap:.2f}")
figure = comparison_figure(measured, simulated, metrics=metrics)
save_figure(figure, "beside_recording.png", force=True)

# %%
# ``clradar register capture.h5 hand.ply -o registered`` does all of it and repeats the simulation
# until the pose no longer moves; ``clradar compare --report`` writes a page to send
# (:doc:`/report`).

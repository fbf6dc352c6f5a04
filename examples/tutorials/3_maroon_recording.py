"""
A MAROON recording
==================

MAROON is a public data set of objects and hands, recorded by the 94 x 94 imager and three cameras
at once. Its recordings are read as they are.
"""

# %%
# Get one
# -------
# Download the data set, some 200 GB, from https://zenodo.org/records/18254440 (public since January
# 2026; licence CC BY-NC: not for commercial use), or its "mini" of 1 GB, which the README of
# https://github.com/vwirth/maroon links, and unpack it. A recording is a folder such as
# ``hand/30``: the object, then the distance in centimetres. In it lie ``radar_72.0_82.0_128`` with
# one file per frame, meshes, ``alignment.json`` and ``metadata.json`` (:doc:`/files`).
#
# Run this script with the folder's name, ``python 3_maroon_recording.py hand/30``. Without one,
# as for the pictures on this page, it writes a recording of the same form itself: two noisy
# frames of a ball, with the ball's mesh.

import sys
from pathlib import Path

import numpy as np
import trimesh

import clradar
import measurement_io
from clradar.plot import comparison_figure, save_figure


def write_recording(folder: Path) -> None:
    """What the data set has for an object, for a ball at x = 20, y = -10, z = 300 mm."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    # In the recording's own radar space x points to the right as the radar sees it.
    to_radar = trimesh.transformations.translation_matrix([-0.02, -0.01, 0.3])
    scene = clradar.Scene.from_mesh(ball, alpha=0.3, transform=np.diag([-1, 1, 1, 1]) @ to_radar)
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 64)
    still = clradar.simulate(scene, clradar.arrays.qar50(), waveform, seed=1)
    ball.export("mesh.obj", include_texture=False)
    measurement_io.save_recording(
        folder,
        [clradar.impair(still, snr_db=10, seed=0, frame=frame) for frame in range(2)],
        timestamps_us=[125_000, 250_000],
        metadata={"distance_meters": 0.3},
        alignment={"photogrammetry2radar": to_radar.tolist()},
        meshes=["mesh.obj"],
    )


folder = Path(sys.argv[1]) if len(sys.argv) == 2 else Path("ball/30")
if not folder.exists():
    write_recording(folder)

# %%
# What is there
# -------------
# ``describe`` lists content, missing parts and contradictions; ``clradar inspect ball/30`` prints
# the same.

print(measurement_io.describe(folder))

# %%
# Its frames
# ----------
# A recording is a sequence of captures, one in memory at a time.

recording = measurement_io.open_recording(folder)
for capture in recording[:3]:
    print(f"frame {capture.meta['frame']} at {capture.meta['timestamp_us']} us")
# The image of the first one, where something is found:
measured = clradar.backproject(recording[0], clradar.place_grid(recording[0]))

# %%
# Its mesh
# --------
# ``scene`` reads the mesh of the photogrammetry and brings it into the frame of the antennas. So
# it can be simulated with the antennas and frequencies of the recording, and compared with the
# measurement.

name = "mesh_masked" if "mesh_masked" in recording.mesh_names else "mesh"
scene = recording.scene(name, alpha=0.3)
capture = clradar.simulate(scene, recording.array, recording.waveform)
simulated = clradar.backproject(capture, measured.grid)
agreement = clradar.compare(measured, simulated)
print(f"overlap {agreement.overlap:.2f}")
figure = comparison_figure(measured, [("its mesh, simulated", simulated)], metrics=[agreement])
save_figure(figure, "maroon.png", force=True)

# %%
# A recording's mesh is rarely where the object was when the radar looked: the next tutorial
# :doc:`finds the pose </tutorials/4_simulation_beside_recording>`.

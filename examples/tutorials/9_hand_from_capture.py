"""
A hand from a capture
=====================

Joint angles of a hand from its radar image alone, without a mesh of it.
"""

# %%
# A measurement
# -------------
# The letter L, made by somebody who does not stretch the index finger: it is bent by 25 degrees.
# We know the truth, so that we can see what the fit finds; of a recording it is
# ``measurement_io.open_capture("hand/30", frame=0)``.

from dataclasses import replace

import numpy as np

import calibration
import clradar
from clradar.hand import JointAngles, hand_mesh, pose_by_name
from clradar.plot import comparison_figure, save_figure

letter = pose_by_name("L")
bent = {"index-finger-phalanx-proximal": JointAngles.from_degrees(25.0, 4.0)}
shown = replace(letter, joints={**letter.joints, **bent})
hand = hand_mesh(shown, edge_length_m=3e-3, center_m=(0.005, -0.008, 0.3))
radar = {"array": clradar.arrays.qar50(), "waveform": clradar.Waveform.sfcw(72e9, 82e9, 48)}
clean = clradar.simulate(clradar.Scene.from_mesh(hand, alpha=0.4), **radar)
capture = clradar.impair(clean, snr_db=20, seed=1)
grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.11, 0.11), (0.25, 0.34), spacing_m=2.5e-3)
measured = clradar.backproject(capture, grid)

# %%
# The fit
# -------
# It starts at the straight L, and moves every joint until the rendering of the hand is like the
# measurement. Without ``closed_loop=False`` it checks itself by simulations, and takes longer.

found = calibration.fit_hand(measured, "L", closed_loop=False, **radar)
print(found.report())

# %%
# Against the truth
# -----------------
# Each finger tip with the standard deviation that the fit states.

digits = ("thumb", "index", "middle", "ring", "pinky")
off_m = np.linalg.norm(found.tips_m - hand.joints_m[[4, 9, 14, 19, 24]], axis=1)
for digit, off, std in zip(digits, off_m, found.tip_std_m, strict=True):
    print(f"{digit}: {1e3 * off:.1f} mm from the truth, {1e3 * std:.1f} mm stated")

# %%
# The picture
# -----------
# The hand that was found, simulated, beside the measurement.

simulated = clradar.backproject(clradar.simulate(found.scene, **radar), grid)
agreement = clradar.compare(measured, simulated)
figure = comparison_figure(measured, [("the fit, simulated", simulated)], metrics=[agreement])
save_figure(figure, "hand_from_capture.png", force=True)

# %%
# How it works, how exact it is, and when it refuses: :doc:`/hand-fit`. A moving hand:
# :doc:`/hand-movement`.

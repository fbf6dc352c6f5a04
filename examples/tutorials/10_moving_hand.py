"""
A moving hand
=============

What the imager shows of a hand that opens while it is recorded. Half a minute on two cores.
"""

# %%
# A hand, its movement, and the radar
# -----------------------------------
# A fist opens within 0.8 s, and comes nearer by 3 cm meanwhile. The radar is the imager with every
# second antenna and 32 frequencies; its Tx take turns, and a sweep takes 15 ms. From the command
# line: ``clradar hand --from S --to flat -o motion.toml`` and
# ``clradar simulate --motion motion.toml --frames 6 -o moving``.

import numpy as np

import clradar
from clradar.plot import comparison_figure, save_figure

nearer = clradar.RigidMotion([0.0, 0.8], [(0, 0, 0), (0, 0, -0.03)], profile="smooth")
hand = clradar.MovingHand([0.0, 0.8], ["S", "flat"], motion=nearer, edge_length_m=4e-3, alpha=0.4)
moving = clradar.MovingScene([hand])
imager = clradar.arrays.qar50().part(slice(None, None, 2), slice(None, None, 2))
waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
timing = clradar.SweepTiming.in_order(imager.n_tx, waveform.n_freq, step_s=10e-6)
grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.12, 0.12), (0.2, 0.36), spacing_m=4e-3)

# %%
# Frame by frame
# --------------
# Each frame is simulated at a few instants of its sweep, as many as the movement needs; where the
# hand rests they are fewer. The truth is that of the middle of the sweep.

images = []
for start_s in (0.0, 0.39):
    capture = clradar.simulate_moving(moving, imager, waveform, timing=timing, start_s=start_s)
    images.append(clradar.backproject(capture, grid))
    tip_m = hand.joints_m(start_s + timing.end_s / 2)[14]
    instants = capture.meta["movement"]["instants"]
    print(f"{start_s:.2f} s: {instants} instants, middle finger tip at {1e3 * tip_m[2]:.0f} mm")

# %%
# Against a hand that stays
# -------------------------
# While the fastest frame is recorded the finger tip moves by wavelengths: echoes that would add up
# do not, and others do.

still = clradar.simulate(moving.at(0.39 + timing.end_s / 2), imager, waveform)
sharp = clradar.backproject(still, grid)
way_m = hand.joints_m(0.39 + timing.end_s)[14] - hand.joints_m(0.39)[14]
print(f"the tip moves by {1e3 * np.linalg.norm(way_m):.1f} mm during the sweep")
agreement = clradar.compare(sharp, images[1])
print(f"overlap of both images: {agreement.overlap:.2f}")

# %%
# The picture
# -----------
# The still hand on the left.

figure = comparison_figure(sharp, [("moving", images[1])], metrics=[agreement])
save_figure(figure, "moving_hand.png", force=True)

# %%
# Motion files, the order of switching and how exact it is: :doc:`/movement`. Following the joints
# of a recording: :doc:`/hand-movement`. Training data of moving hands: :doc:`/datasets`.

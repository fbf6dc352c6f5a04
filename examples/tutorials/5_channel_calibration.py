"""
Channel calibration
===================

Every transmitter and receiver has its own gain, phase and delay. Until they are known, a real array
forms no image: find them from a metal plate, and remove them.
"""

# %%
# An instrument
# -------------
# 32 transmitters and 32 receivers, every third of the 94 x 94 imager. ``draw_channels`` gives
# each channel any phase, 3 dB more or less, and 20 ps of delay: the errors that we pretend not to
# know.

import calibration
import clradar
from clradar.hand import hand_mesh
from clradar.plot import panels_figure, save_figure

imager = clradar.arrays.qar50()
array = clradar.AntennaArray(imager.tx_m[::3], imager.rx_m[::3])
waveform = clradar.Waveform.sfcw(72e9, 82e9, 64)
errors = clradar.draw_channels(array, waveform, seed=0)

# %%
# What it records of a hand
# -------------------------

hand = clradar.Scene.from_mesh(hand_mesh("L", edge_length_m=3e-3), alpha=0.3)
ideal = clradar.simulate(hand, array, waveform)
recorded = clradar.impair(ideal, channels=errors, snr_db=20, seed=1)

# %%
# What it records of a plate
# --------------------------
# A metal plate, 30 cm away and tilted by a degree, reflects every transmitter into every
# receiver. ``response`` is its echo in closed form; in a laboratory this is one more recording.

plate = calibration.FlatPlate(0.3, 1.0, 0.0)
echo = clradar.Capture(calibration.response(plate, array, waveform), array, waveform)
of_plate = clradar.impair(echo, channels=errors, snr_db=20, seed=2)

# %%
# The channels
# ------------
# We say where the plate is to a centimetre and two degrees; its exact pose is found with the
# channels.

channels = calibration.estimate_channels(of_plate, calibration.FlatPlate(0.302))
corrected = calibration.correct(recorded, channels)

# %%
# Before and after
# ----------------
# The same recording, before and after the correction, beside what an instrument without errors
# has.

grid = clradar.VoxelGrid.from_extent((-0.09, 0.09), (-0.108, 0.108), (0.27, 0.33), spacing_m=3e-3)
captures = {"recorded": recorded, "corrected": corrected, "without errors": ideal}
images = {name: clradar.backproject(c, grid, check_grid=False) for name, c in captures.items()}
for name in ("recorded", "corrected"):
    agreement = clradar.compare(images["without errors"], images[name])
    print(f"{name}: overlap {agreement.overlap:.2f}")
figure = panels_figure([[(name, image.depth_map()) for name, image in images.items()]])
save_figure(figure, "channels.png", force=True)

# %%
# With files this is ``clradar channels plate.h5 --target plate --distance-mm 300 -o channels.h5``
# and ``clradar clean hand.h5 --channels channels.h5 -o corrected.h5``. Which targets there are,
# how to set them up, and what no target tells: :doc:`/channel-calibration`.

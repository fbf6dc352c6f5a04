"""
A data set to a classifier
==========================

Make radar images of many hands, and learn to tell fists from flat hands. Needs
``pip install ".[dataset]" scikit-learn``.
"""

# %%
# A plan
# ------
# What the samples are, and what is drawn at random for each: hands of random adults, left and
# right, in random places, of random roughness, in noise. This one is tiny: 28 hands, every third
# antenna and voxels of 5 mm, a fraction of a second each. ``examples/plans/letters.toml`` in the
# repository is one to learn letters from.

from pathlib import Path

import matplotlib.figure
import numpy as np
from scipy.ndimage import gaussian_filter
from sklearn.decomposition import PCA
from sklearn.pipeline import make_pipeline
from sklearn.svm import SVC

import clradar
from clradar.dataset import read_plan, run

Path("plan.toml").write_text("""
seed = 1
samples = 28
poses.names = ["A", "B"]
hands = { handedness = "both", shape = "sampled", edge_mm = 4 }
placement.x_mm = { uniform = [-10, 10] }
placement.y_mm = { uniform = [-10, 10] }
placement.z_mm = { uniform = [290, 310] }
alpha.palm = { uniform = [0.3, 0.8] }
alpha.others = { uniform = [0.2, 0.7] }
impairments.snr_db = { uniform = [0, 20] }
radar = { every = 3, steps = 32 }
simulation.samples_per_mm2 = 0.1
image.step_mm = 5
output.products = ["max_projection", "depth_map"]
""")

# %%
# The data set
# ------------
# ``clradar dataset plan.toml -o hands`` does the same. Called again it resumes, and when nothing
# is missing it is done at once.

run(read_plan("plan.toml"), Path("hands"))
data = clradar.open_dataset("hands")
print(data.sizes["sample"], "images of", data.max_projection.shape[1:], "pixels")

# %%
# Learn and test
# --------------
# Bright pixels, in decibels, each image relative to its maximum and blurred over a centimetre, so
# that hands in other places are still alike. The first 20 hands are learned, the other 8 are new.

images = data.max_projection.values
decibels = 20 * np.log10(images / images.max(axis=(1, 2), keepdims=True) + 1e-3)
blurred = gaussian_filter(np.maximum(decibels, -25), (0, 2, 2))
x, y = blurred.reshape(len(images), -1), data.pose.values
known = np.arange(len(y)) < 20
model = make_pipeline(PCA(8, random_state=0), SVC(C=10)).fit(x[known], y[known])
guessed = model.predict(x[~known])
print(f"{np.count_nonzero(guessed == y[~known])} of {len(guessed)} new hands are right")

# %%
# The new hands, and what they were taken for
# -------------------------------------------
# A is the fist, B the flat hand. What lies at the edges are copies of the hand (grating lobes),
# since two of three antennas are left out.

figure = matplotlib.figure.Figure(figsize=(9, 4.5), layout="constrained")
for axes, image, pose, guess in zip(
    figure.subplots(2, 4).flat, decibels[~known], y[~known], guessed, strict=True
):
    # x increases to the left, as the radar sees it.
    axes.imshow(image[:, ::-1], origin="lower", vmin=-15, vmax=0, cmap="inferno")
    axes.set_title(f"{pose}, taken for {guess}")
    axes.set_axis_off()
figure.savefig("hands.png", dpi=100)

# %%
# Keys of a plan, files and costs: :doc:`/datasets`; several cores and machines:
# :doc:`/datasets-cluster`. ``examples/train_letters.py`` does this with all letters.

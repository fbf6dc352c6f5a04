"""
Physical surfaces
=================

Surfaces of materials with a roughness in millimetres: echoes on an absolute scale, in dBsm.
"""

# %%
# A ball of known echo
# --------------------
# The radar cross section of a metal ball much larger than the wavelength is its disc, pi r^2. A
# scene with a material is simulated by the *physical* estimator, and its capture holds
# S-parameters. A voxel reads a little less than the ball has, since the glint is elsewhere for
# other antennas (:doc:`/absolute-scale`).

import numpy as np
import trimesh

import clradar
from clradar.plot import panels_figure, save_figure

imager = clradar.arrays.qar50()
array = clradar.AntennaArray(imager.tx_m[::2], imager.rx_m[::2])
waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
grid = clradar.VoxelGrid.from_extent((-0.05, 0.05), (-0.05, 0.05), (0.28, 0.32), spacing_m=2e-3)


def image_of(mesh: trimesh.Trimesh, material: object, seed: int = 0) -> clradar.Volume:
    scene = clradar.Scene.from_mesh(mesh, material=material)
    capture = clradar.simulate(scene, array, waveform, seed=seed)
    return clradar.backproject(capture, grid, check_grid=False)


radius_m = 5e-3
ball = trimesh.creation.icosphere(subdivisions=4, radius=radius_m)
volume = image_of(ball.apply_translation([0, 0, 0.3]), "metal")
print(f"theory {10 * np.log10(np.pi * radius_m**2):.1f} dBsm, read {volume.rcs_dbsm().max():.1f}")

# %%
# Other materials
# ---------------
# Skin reflects less: at 77 GHz its reflection coefficient is about 0.6. ``clradar materials``
# lists what comes along; your own have a permittivity, a coating, and a roughness
# (:doc:`/materials`).

volume = image_of(ball, "skin")
skin = clradar.material("skin")
loss_db = 20 * np.log10(abs(skin.reflection([77e9], [1.0])[0, 0]))
print(f"skin: {loss_db:.1f} dB by its reflection, read {volume.rcs_dbsm().max():.1f} dBsm")

# %%
# Roughness
# ---------
# A plate of 8 cm in front of so wide an array is seen whole: every point of it mirrors some
# transmitter into some receiver. Heights of 0.2 mm RMS, correlated over 4 mm, send a third of
# that power elsewhere, and 0.5 mm more than nine tenths. The image becomes grainy, then speckle:
# its contrast, the standard deviation of the power over its mean, goes towards 1. The surface
# itself is drawn: another seed is another plate.

corners = [(x, y, 0.3) for x in (-0.04, 0.04) for y in (-0.04, 0.04)]
plate = trimesh.Trimesh(corners, [(0, 1, 2), (1, 3, 2)])

panels = []
for height_mm in (0.0, 0.2, 0.5):
    rough = {"roughness_rms_m": 1e-3 * height_mm, "correlation_length_m": 4e-3}
    material = clradar.Material("metal", conductor=True, **(rough if height_mm else {}))
    volume = image_of(plate, material)
    power = volume.max_projection()[8:43, 8:43] ** 2  # 3.4 cm about the middle
    print(f"h = {height_mm} mm: contrast {power.std() / power.mean():.2f}")
    panels.append((f"h = {height_mm} mm", volume.depth_map(dynamic_range_db=20)))
figure = panels_figure([panels], "A metal plate, smooth and rough")
save_figure(figure, "roughness.png", force=True)

# %%
# How right this is: :doc:`/validation`. How roughness is found from a measurement: :doc:`/sweep`.
# Which estimator to take: :doc:`/choosing`.

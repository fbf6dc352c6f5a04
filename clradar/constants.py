"""Physical constants and shared conventions."""

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
"""Speed of light in vacuum, m/s (exact by definition of the metre)."""

VACUUM_PERMITTIVITY_F_PER_M = 8.854_187_8128e-12  # electric constant, F/m (CODATA 2018)
DYNAMIC_RANGE_DB = 15.0
"""Images and depth maps are cut this far below their maximum, as in the paper."""

PLAUSIBLE_HZ = (1e8, 1e12)  # frequencies of an imaging radar; others are in another unit than hertz
MAX_FREQUENCIES = 10_000_000  # most frequencies of a waveform
PLAUSIBLE_APERTURE_M = (1e-3, 5.0)
"""Largest extent of a near-field array along an axis; others are in another unit than metres."""

FINEST_SPACING_M = 1e-5
"""Least distance of neighbouring voxels, a thirtieth of the shortest plausible wavelength. There is
no greatest: far from a small array of narrow band, 1 m is fine enough."""

PLAUSIBLE_RANGE_M = (1e-3, 100.0)
"""Distance from the aperture's centre of the farthest voxel or point of a scene. The near field of
an array of 14 cm at 77 GHz ends at 10 m, that of one of 44 cm at 100 m."""

PLAUSIBLE_RADIUS_M = (1e-4, 1.0)
"""Radius of the sphere in which a receiver takes in rays. A smaller one takes in next to none, a
larger one is no point."""

PLAUSIBLE_ROUGHNESS_M = (0.0, 0.01)
"""Root-mean-square height of a surface; a larger one belongs into the mesh."""

PLAUSIBLE_CORRELATION_M = (1e-5, 0.1)  # correlation length of a surface's heights
PLAUSIBLE_MICRO_ROUGHNESS_M = (0.0, 1e-3)
"""Root-mean-square height of what is finer than the samples of a surface."""

PLAUSIBLE_COATING_M = (1e-7, 0.01)
"""Thickness of a coating. Reflection by a thicker one changes too fast with the angle for the
tables of the kernels: they are off by 2e-3 for 5 mm without loss, 4e-2 for 20 mm."""

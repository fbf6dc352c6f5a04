"""Physical constants and shared conventions."""

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
"""Speed of light in vacuum, m/s (exact by definition of the metre)."""

DYNAMIC_RANGE_DB = 15.0
"""Images and depth maps are cut this far below their maximum, as in the paper."""

PLAUSIBLE_HZ = (1e8, 1e12)
"""Frequencies of an imaging radar; others are in another unit than hertz."""

MAX_FREQUENCIES = 10_000_000
"""Most frequencies of a waveform."""

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

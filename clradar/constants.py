"""Physical constants and shared conventions."""

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
"""Speed of light in vacuum, m/s (exact by definition of the metre)."""

DYNAMIC_RANGE_DB = 15.0
"""Images and depth maps are cut this far below their maximum, as in the paper."""

PLAUSIBLE_HZ = (1e8, 1e12)
"""Frequencies of an imaging radar; a file with others states them in another unit than hertz."""

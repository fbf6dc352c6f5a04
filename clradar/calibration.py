"""Calibration of recordings, and registration of simulations to them: the package `calibration`.

That is its name where it lies, and remains usable; this one no other package can take.
"""

from typing import TYPE_CHECKING

from clradar.files.second_name import stand_for

if TYPE_CHECKING:
    from calibration import *  # noqa: F403

stand_for(__name__, "calibration")

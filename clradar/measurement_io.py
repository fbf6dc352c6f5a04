"""Recorded captures and the native HDF5 file: the package `measurement_io`.

That is its name where it lies, and remains usable; this one no other package can take.
"""

from typing import TYPE_CHECKING

from clradar.files.second_name import stand_for

if TYPE_CHECKING:
    from measurement_io import *  # noqa: F403

stand_for(__name__, "measurement_io")

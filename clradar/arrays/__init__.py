"""Antenna arrays: known instruments, files of others, and what they resolve and confuse."""

from clradar.arrays.array_file import read_array, read_clusters
from clradar.arrays.figures_of_merit import ArrayFigures, Lobe, array_figures
from clradar.arrays.instruments import qar50

__all__ = ["ArrayFigures", "Lobe", "array_figures", "qar50", "read_array", "read_clusters"]


def __dir__() -> list[str]:
    return sorted(__all__)

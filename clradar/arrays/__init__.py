"""Antenna arrays: known instruments, files of others, and what they resolve and confuse."""

from clradar.arrays.array_file import read_array, read_clusters
from clradar.arrays.instruments import qar50
from clradar.arrays.lobes import ArrayFigures, Lobe, array_figures

__all__ = ["ArrayFigures", "Lobe", "array_figures", "qar50", "read_array", "read_clusters"]


def __dir__() -> list[str]:
    return sorted(__all__)

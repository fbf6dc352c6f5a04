"""Write a record in the format that its file's name asks for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from clradar.errors import OutputError
from clradar.files.atomic import refuse_existing, replacing
from clradar.files.failures import shown
from clradar.model import Capture, DepthMap, Volume, checks
from measurement_io.export.arrays import require_mat, write_mat, write_npz
from measurement_io.export.ply import write_ply_surface
from measurement_io.export.vti import write_vti

Exported = Capture | Volume | DepthMap

FORMATS: dict[str, tuple[type, ...]] = {
    ".vti": (Volume,),
    ".ply": (DepthMap,),
    ".mat": (Capture, Volume, DepthMap),
    ".npz": (Capture, Volume, DepthMap),
}
"""Ending of a name -> what such a file can hold."""

_NOUNS = {Capture: "a capture", Volume: "a volume", DepthMap: "a depth map"}
_WAYS = {
    Capture: "form its image first (backproject, `clradar image`)",
    Volume: "take its depth map (Volume.depth_map, `clradar export --depth-map`)",
    DepthMap: "take the volume that it is made of",
}
_WRITERS: dict[str, Callable[..., None]] = {
    ".vti": write_vti,
    ".ply": write_ply_surface,
    ".mat": write_mat,
    ".npz": write_npz,
}


def export_file(path: str | os.PathLike[str], record: Exported, *, force: bool = False) -> None:
    """Write a capture, a volume or a depth map for another program, whole or not at all.

    Parameters
    ----------
    path : path-like
        The ending of the name decides: .vti (ParaView, VTK) holds a volume, .ply (MeshLab, Blender,
        trimesh) a depth map; .mat (MATLAB v5) and .npz (numpy) hold anything. docs/files.md has
        what is in each. Its folder has to exist.
    record : Capture, Volume or DepthMap
        Antenna patterns and the scale of a volume are left out.
    force : bool
        Replace an existing file.

    Raises
    ------
    OutputError
        Another ending, a record or an array (.mat: beyond 2 GiB) that such a file cannot hold, or
        the file exists, its folder does not, or the system refuses to write. Nothing half-written
        stays behind.
    ModelError
        No such record, `meta` holds what JSON cannot hold, or a depth map without a depth as .ply.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from measurement_io import export_file
    >>> grid = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (3, 2, 4))
    >>> volume = clradar.Volume(np.ones(grid.shape), grid)
    >>> export_file("volume.npz", volume)
    >>> with np.load("volume.npz") as file:
    ...     file["data"].shape, file["z_m"].tolist()
    ((4, 2, 3), [0.3, 0.301, 0.302, 0.303])
    >>> export_file("surface.ply", volume)
    Traceback (most recent call last):
    clradar.errors.OutputError: surface.ply: a .ply file holds a depth map, got a volume; take ...
    """
    target = Path(path)
    check_export(target, type(record))
    refuse_existing(target, force=force)
    if target.suffix.lower() == ".mat":
        require_mat(target, record)
    with replacing(target, force=force) as temporary:
        _WRITERS[target.suffix.lower()](temporary, record)


def check_export(target: Path, kind: type) -> None:
    """Raise unless a file of this name can hold a record of this class."""
    suffix = target.suffix.lower()
    if suffix not in FORMATS:
        raise OutputError(
            f"{shown(target)}: expected a name that ends in {', '.join(FORMATS)}, "
            f"got '{target.suffix}'"
        )
    if kind not in _NOUNS:
        checks.fail("export_file: record", "a Capture, a Volume or a DepthMap", kind.__name__)
    if kind not in FORMATS[suffix]:
        held = " or ".join(_NOUNS[one] for one in FORMATS[suffix])
        raise OutputError(
            f"{shown(target)}: a {suffix} file holds {held}, got {_NOUNS[kind]}; {_WAYS[kind]}"
        )

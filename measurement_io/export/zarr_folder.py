"""Records as zarr groups, which `xarray.open_zarr` reads."""

from __future__ import annotations

import os
from pathlib import Path

from clradar.errors import MissingPackage, OutputError
from clradar.files.atomic import move_folder, new_folder, swap_folder
from clradar.files.failures import shown
from clradar.model import Capture, DepthMap, Volume

ZARR_FORMAT = 2
"""Of the Zarr specification: version 3 has no type for texts of fixed length yet."""

MARKS = (".zgroup", "zarr.json")
INSTALL = "pip install 'clradar[export]'"


def write_zarr(target: Path, record: Capture | Volume | DepthMap, *, force: bool) -> None:
    """Write what `to_xarray` gives as a folder; with `force` another zarr folder is replaced."""
    _refuse(target, force=force)
    try:
        import zarr  # noqa: F401 - here, so that the error names what to install
    except ImportError as error:
        raise MissingPackage(f"export_file: expected zarr, got {error}; {INSTALL}") from error
    found = record.to_xarray()
    content = found.to_dataset() if isinstance(record, Volume) else found
    with new_folder(target) as temporary:
        made = temporary / "made"
        content.to_zarr(made, mode="w-", zarr_format=ZARR_FORMAT, consolidated=True)
        _refuse(target, force=force)
        if os.path.lexists(target):
            swap_folder(made, target, temporary / "replaced")
        else:
            move_folder(made, target)


def _refuse(target: Path, *, force: bool) -> None:
    """Raise `OutputError` unless the folder may be made, or be replaced."""
    if not target.absolute().parent.is_dir():
        raise OutputError(
            f"{shown(target)}: expected an existing folder, got '{shown(target.parent)}'"
        )
    if not os.path.lexists(target):
        return
    if not target.is_dir() or not any((target / mark).is_file() for mark in MARKS):
        raise OutputError(f"{shown(target)}: is there, and is no zarr folder; choose another name")
    if not force:
        raise OutputError(f"{shown(target)}: exists already; not overwritten without force")

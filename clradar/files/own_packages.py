"""The packages beside `clradar`, and never a user's file of the same name."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path

from clradar.errors import PackageError
from clradar.files.failures import shown

ROOT = Path(__file__).resolve().parents[2]
"""The folder that `clradar`, `measurement_io` and `calibration` are installed in."""


def require_own(*names: str) -> None:
    """Raise unless Python finds the packages of these names where clradar is installed.

    Python takes the first file of a name on its path, and the folder of a script comes first: a
    ``calibration.py`` there hides the package `calibration`.

    Raises
    ------
    PackageError
        It names the file that hides the package.
    """
    for name in names:
        if not (ROOT / name / "__init__.py").is_file():
            continue  # installed in another way than side by side: nothing to compare with
        found = _file_of(name)
        if found is None:
            raise PackageError(f"{shown(ROOT)}: expected this folder on Python's path")
        if found.resolve() != ROOT / name / "__init__.py":
            raise PackageError(
                f"{shown(found)}: hides clradar's own package '{name}' by its name; rename it, or "
                "take its folder off Python's path"
            )


def _file_of(name: str) -> Path | None:
    """The file or the folder that ``import name`` takes, or has taken."""
    loaded = sys.modules.get(name)
    if loaded is not None and getattr(loaded, "__file__", None):
        return Path(str(loaded.__file__))
    spec = find_spec(name) if loaded is None else None
    if spec is None:
        return None
    if spec.origin is not None and spec.has_location:
        return Path(spec.origin)
    folders = spec.submodule_search_locations  # a folder without __init__.py
    return Path(next(iter(folders))) if folders else None


def leave_current_folder() -> None:
    """Take the current folder off Python's path, where ``python -m`` puts it first.

    A command reads files there and imports none. Where clradar itself lies in it, it stays.
    """
    first = os.path.realpath(sys.path[0])
    if first == os.path.realpath(os.curdir) and first != str(ROOT):
        del sys.path[0]

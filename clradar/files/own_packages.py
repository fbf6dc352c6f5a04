"""The packages beside `clradar`, and never a file of the same name of a user or a package."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path

from clradar.errors import PackageError
from clradar.files.failures import shown

ROOT = Path(__file__).resolve().parents[2]
"""The folder that `clradar`, `measurement_io` and `calibration` are installed in."""


MARK = "# A package of clradar: clradar/files/own_packages.py looks for this line."
"""In the ``__init__.py`` of our packages, and of no other package of that name."""


def require_own(*names: str) -> None:
    """Raise unless Python finds the packages of these names where clradar is installed, as ours.

    Python takes the first file of a name on its path, and the folder of a script comes first: a
    ``calibration.py`` there hides the package `calibration`. An installed package of that name
    replaces files of ours, or takes them away when it is uninstalled.

    Raises
    ------
    PackageError
        It names the file, and the package that it belongs to.
    """
    for name in names:
        ours = ROOT / name / "__init__.py"
        if not ours.parent.is_dir():
            continue  # installed in another way than side by side: nothing to compare with
        found = _file_of(name)
        if found is None:
            raise PackageError(f"{shown(ROOT)}: expected this folder on Python's path")
        if found.resolve() not in (ours, ours.parent):
            remedy = "rename it, or take its folder off Python's path"
            if owner := _owner_of(found):
                remedy = f"it belongs to the package '{owner}': uninstall that"
            hidden = f"hides clradar's own package '{name}' by its name"
            raise PackageError(f"{shown(found)}: {hidden}; {remedy}")
        if not ours.is_file() or MARK not in ours.read_text(encoding="utf-8", errors="replace"):
            raise PackageError(f"{shown(ours)}: {_loss_of(ours)}")


def _loss_of(ours: Path) -> str:
    """What has happened to a file of ours, and what to do."""
    what = f"of clradar's own package '{ours.parent.name}'"
    again = "install clradar again (pip install --force-reinstall --no-deps clradar)"
    if not ours.exists():
        return f"expected the file {what}, which another package has taken away; {again}"
    owner = _owner_of(ours)
    other = "another package" if owner is None else f"the package '{owner}'"
    return f"expected the file {what}, got that of {other}; uninstall that, then {again}"


def _owner_of(file: Path) -> str | None:
    """The installed package, other than clradar, that a file or a folder of a module is of."""
    from importlib.metadata import distributions

    file = file / "__init__.py" if file.is_dir() else file
    for package in distributions():
        name = package.metadata["Name"]
        if name and name.lower() != "clradar":
            for part in package.files or ():
                if part.name == file.name and Path(str(part.locate())).resolve() == file.resolve():
                    return str(name)
    return None


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
    try:
        first, here = os.path.realpath(sys.path[0]), os.path.realpath(os.curdir)
    except FileNotFoundError:  # the current folder was removed
        return
    if first == here and first != str(ROOT):
        del sys.path[0]

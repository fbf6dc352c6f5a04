"""The packages that take part in a result: their versions, and that ours are ours."""

from __future__ import annotations

import sys
from contextlib import suppress
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from clradar.errors import PackageError

PACKAGES = ("numpy", "scipy", "pyopencl", "pocl-binary-distribution", "trimesh", "h5py")
"""The packages whose version can change a result."""

ROOT = Path(__file__).resolve().parents[1]
"""The folder that `clradar`, `measurement_io` and `calibration` are installed in."""


def own_version() -> str:
    """The version of clradar."""
    return str(sys.modules["clradar"].__version__)


def package_versions() -> dict[str, str]:
    """Versions of the installed ones of `PACKAGES`."""
    versions = {}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


def require_own(*names: str) -> None:
    """Raise `PackageError` where another module hides our package of that name from Python."""
    for name in names:
        ours, spec = {str(ROOT / name), str(ROOT / name / "__init__.py")}, find_spec(name)
        found = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
        if found and not ours & set(found):
            raise PackageError(
                f"{next(filter(None, found))}: hides clradar's own package '{name}' by its name; "
                "rename it, or take its folder off Python's path"
            )

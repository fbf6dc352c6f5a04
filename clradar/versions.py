"""Versions of the packages that take part in a result, for provenance."""

from __future__ import annotations

from importlib import metadata

PACKAGES = ("numpy", "scipy", "pyopencl", "pocl-binary-distribution", "trimesh", "h5py")
"""The packages whose version can change a result."""


def package_versions() -> dict[str, str]:
    """Versions of the installed ones of `PACKAGES`."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions

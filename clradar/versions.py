"""Versions of what takes part in a result."""

from __future__ import annotations

from importlib import metadata

PACKAGES = ("numpy", "scipy", "pyopencl", "pocl-binary-distribution", "trimesh", "h5py")
"""The packages whose version can change a result."""


def package_versions() -> dict[str, str]:
    """Return the versions of the packages in `PACKAGES` that are installed."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions

"""What every written capture and volume carries about how it came to be."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from clradar import __version__

PACKAGES = ("numpy", "scipy", "pyopencl", "pocl-binary-distribution", "trimesh", "h5py")
"""The packages whose version can change a result."""

HASH_BLOCK_BYTES = 2**20


def provenance(
    command: str, settings: Mapping[str, Any], inputs: Sequence[Path] = ()
) -> dict[str, Any]:
    """Return what goes into the `meta` of a written file.

    Parameters
    ----------
    command : str
        The subcommand.
    settings : mapping
        Its resolved options, in types that JSON knows.
    inputs : sequence of Path
        The files it read; their SHA-256 is part of the record.

    Returns
    -------
    dict
        Keys ``clradar``, ``packages``, ``python``, ``machine``, ``command``, ``options`` and
        ``inputs``: they clash with none of those that simulation and image formation write.
    """
    return {
        "clradar": __version__,
        "packages": package_versions(),
        "python": platform.python_version(),
        "machine": platform.platform(),
        "command": command,
        "options": dict(settings),
        "inputs": [{"file": path.name, "sha256": sha256_of(path)} for path in inputs],
    }


def package_versions() -> dict[str, str]:
    """Return the versions of the packages in `PACKAGES` that are installed."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    state = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            state.update(block)
    return state.hexdigest()

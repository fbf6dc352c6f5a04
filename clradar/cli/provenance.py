"""Provenance: the record in every written file of the command, its options and its inputs."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clradar import __version__
from clradar.files.hashing import sha256_of
from clradar.versions import package_versions


def provenance(
    command: str, options: Mapping[str, Any], inputs: Sequence[Path] = ()
) -> dict[str, Any]:
    """The record that goes into the `meta` of a written file.

    Parameters
    ----------
    command : str
        The subcommand.
    options : mapping
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
        "options": dict(options),
        "inputs": [{"file": path.name, "sha256": sha256_of(path)} for path in inputs],
    }

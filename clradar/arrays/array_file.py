"""Files of antenna arrays: TOML, positions or rules that place them; ``docs/arrays.md``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.failures import fail, reading
from clradar.files.limits import MAX_LONG_TOML_BYTES
from clradar.files.toml_file import read_toml, toml_document
from clradar.model import AntennaArray


def read_array(path: str | os.PathLike[str]) -> AntennaArray:
    """Return the array of a TOML file; docs/arrays.md has its keys.

    Examples
    --------
    >>> clradar.arrays.read_array("cross60.toml").n_tx
    12
    """
    return _only(read_clusters(path), path)


def read_clusters(path: str | os.PathLike[str]) -> tuple[AntennaArray, ...]:
    """Return the arrays of a TOML file, one for each pose where it has ``pairs = "cluster"``.

    A Tx then is measured with the Rx of its own pose only: each pose has a capture of its own, of
    all of which `clradar.backproject` makes one image. Without that key it is one array.

    Examples
    --------
    >>> len(clradar.arrays.read_clusters("cross60.toml"))
    1
    """
    path = Path(path)
    expected = "an antenna array (a TOML file, see docs/arrays.md)"
    return _arrays(read_toml(path, expected, limit=MAX_LONG_TOML_BYTES), str(path), path.stem)


def array_of(content: Mapping[str, Any], source: str, name: str) -> AntennaArray:
    """Return the array of a table in the vocabulary of files; `source` is named in messages."""
    return _only(_arrays(content, source, name), source)


def array_record(array: AntennaArray) -> dict[str, Any]:
    """Return a table that `array_of` makes the same array of, to the bit."""
    record: dict[str, Any] = {"name": array.name}
    patterns = {}
    for name, side in zip(("tx", "rx"), array.sides, strict=True):
        own: dict[str, Any] = {"points_m": side.antennas_m.tolist()}
        if side.gain is not None:
            own["gain"] = np.stack([side.gain.real, side.gain.imag], axis=1).tolist()
        if side.boresight is not None:
            own["boresight"] = side.boresight.tolist()
        record[name] = [own]
        if side.pattern is not None:
            given = ((f.name, getattr(side.pattern, f.name)) for f in fields(side.pattern))
            known = {key: np.asarray(v).tolist() for key, v in given if v is not None}
            patterns[f"{name}_pattern"] = known
    return record | patterns


def array_text(array: AntennaArray) -> str:
    """Return the text of a file that `read_array` makes the same array of, to the bit."""
    record = array_record(array)
    text = toml_document({**record, "tx": record["tx"][0], "rx": record["rx"][0]})
    return text.replace("\n[tx]\n", "\n[[tx]]\n").replace("\n[rx]\n", "\n[[rx]]\n")


def _arrays(content: Mapping[str, Any], source: str, name: str) -> tuple[AntennaArray, ...]:
    from clradar.arrays.array_record import ArrayFile
    from clradar.files.records import record_of

    record = record_of(dict(content), ArrayFile, source)
    with reading(source, "an antenna array"):
        return record.arrays(name)


def _only(found: Sequence[AntennaArray], source: str | os.PathLike[str]) -> AntennaArray:
    if len(found) > 1:
        got = f"{len(found)} clusters, which simulate and image take"
        fail(f"{source}: pairs", 'one array ("all", or a single pose)', got)
    return found[0]

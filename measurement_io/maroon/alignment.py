"""Transforms in JSON: `alignment.json` of a recording, and files of one matrix.

A key "<a>2<b>" holds the row-major 4 x 4 matrix T of p_b = T p_a. Radar and photogrammetry are in
metres; the optical sensors in millimetres, so their matrices carry a scale. "radar" is the mirrored
radar space of the recording: p_radar = diag(-1, 1, 1) p_antenna.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, GetPydanticSchema, RootModel

from clradar.errors import ModelError
from clradar.files.failures import clean, fail, reading, shown
from clradar.files.json_file import read_json, read_json_object
from clradar.files.records import OpenRecord, Rows, mistake, record_of
from clradar.model import checks

RADAR = "radar"
MESH_SOURCE = "photogrammetry"  # the frame of reference of a recording's meshes
MIRROR_X = np.diag([-1.0, 1.0, 1.0, 1.0])  # radar space to antenna frame, and back
MIRROR_X.flags.writeable = False

LAST_ROW_ROUNDING = 1e-9
"""How far the last row of a matrix may be from 0 0 0 1, for matrices that were multiplied."""

_NAME = re.compile("[A-Za-z][A-Za-z0-9_-]*")


def _rows(value: Any) -> Any:
    flat = isinstance(value, list) and len(value) == 16
    return [value[i : i + 4] for i in range(0, 16, 4)] if flat else value


def _matrix(rows: Any) -> np.ndarray:
    """Return a 4 x 4 matrix from four rows of four numbers."""
    matrix = np.array(rows)
    if matrix.shape != (4, 4):
        raise mistake("four rows of four numbers", f"shape {matrix.shape}")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() <= LAST_ROW_ROUNDING:
        matrix[3] = (0, 0, 0, 1)
    try:
        return checks.transform("it", matrix)
    except ModelError as error:
        raise mistake("an invertible affine transform", clean(error)) from error


_FROM_ROWS = Annotated[Rows, BeforeValidator(_rows), AfterValidator(_matrix)]
Matrix = Annotated[Any, GetPydanticSchema(lambda _, handler: handler(_FROM_ROWS))]


class _Transform(OpenRecord):
    transform: Matrix


class _Transforms(RootModel[dict[str, Matrix]]):
    pass


@dataclass(frozen=True, slots=True, eq=False)
class SensorAlignment:
    """The transforms of one `alignment.json`.

    Attributes
    ----------
    path : str
    given : mapping of (source, target) to ndarray, shape (4, 4)
        What the file holds: p_target = T p_source.
    """

    path: str
    given: Mapping[tuple[str, str], np.ndarray]

    def transform(self, source: str, target: str) -> np.ndarray:
        """Return the 4 x 4 matrix from `source` to `target`, in the units of the two.

        Names are as in the file: "radar" (metres, mirrored in x), "photogrammetry" (metres),
        "kinect", "zed", "realsense" (millimetres). What is not given goes by way of the radar, or
        is inverted.
        """
        steps = {(b, a): np.linalg.inv(matrix) for (a, b), matrix in self.given.items()}
        steps |= {**self.given, **{(name, name): np.eye(4) for name in (source, RADAR, target)}}
        known = source == target or (source, target) in self.given
        if not known and (source, RADAR) in steps and (RADAR, target) in steps:
            return steps[RADAR, target] @ steps[source, RADAR]
        if (source, target) in steps:
            return steps[source, target].copy()
        names = ", ".join(f"{a}2{b}" for a, b in sorted(self.given)) or "no transform"
        fail(self.path, f"a transform from '{clean(source)}' to '{clean(target)}'", clean(names))

    def to_antenna(self, source: str) -> np.ndarray:
        """Return the 4 x 4 matrix from `source` to the antenna frame, metres.

        diag(-1, 1, 1, 1) <source>2radar; where its determinant is negative, turn the winding of a
        mesh's faces.
        """
        return MIRROR_X @ self.transform(source, RADAR)


def read_alignment(path: str | os.PathLike[str]) -> SensorAlignment:
    """Return the transforms of an `alignment.json`; those that are null are left out.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("alignment.json").write_text('''{"kinect2radar":
    ...     [[0.001, 0, 0, 0.1], [0, 0.001, 0, 0], [0, 0, 0.001, 0], [0, 0, 0, 1]]}''')
    >>> alignment = measurement_io.read_alignment("alignment.json")
    >>> (alignment.transform("kinect", "radar") @ [200, 0, 300, 1])[:3].round(3).tolist()
    [0.3, 0.0, 0.3]
    """
    path = Path(path)
    content = read_json_object(path)
    pairs = {key: _pair(key) for key, value in content.items() if value is not None}
    known = {key: pair for key, pair in pairs.items() if pair is not None}
    matrices = record_of({key: content[key] for key in known}, _Transforms, path).root
    with reading(path, "transforms between sensors"):
        given = {pair: matrices[key] for key, pair in known.items()}
        return SensorAlignment(shown(path), MappingProxyType(given))


def _pair(key: str) -> tuple[str, str] | None:
    """Return source and target of "<a>2<b>"; None for anything else."""
    # A sensor's own name may hold a 2; the radar's does not.
    if key.startswith(f"{RADAR}2"):
        source, _, target = key.partition("2")
    elif key.endswith(f"2{RADAR}") or key.count("2") == 1:
        source, _, target = key.rpartition("2")
    else:
        return None
    return (source, target) if _NAME.fullmatch(source) and _NAME.fullmatch(target) else None


def read_transform(path: str | os.PathLike[str]) -> np.ndarray:
    """Return the matrix of a JSON file, shape (4, 4), metres.

    The file holds four rows of four numbers, sixteen numbers, or an object whose "transform" is one
    of the two. Of an `alignment.json` it is the matrix that moves the recording's own meshes into
    the antenna frame.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("motion.json").write_text(
    ...     '{"transform": [[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}')
    >>> (measurement_io.read_transform("motion.json") @ [1, 0, 0, 1])[:3].tolist()
    [0.1, 1.0, 0.0]
    """
    path = Path(path)
    expected = "a JSON file with a 4 x 4 matrix, or an object with one as 'transform'"
    value = read_json(path, expected)
    if isinstance(value, dict) and any(MESH_SOURCE in str(key).split("2") for key in value):
        return read_alignment(path).to_antenna(MESH_SOURCE)
    value = value if isinstance(value, dict) else {"transform": value}
    return record_of(value, _Transform, path).transform

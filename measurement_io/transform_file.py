"""A 4 x 4 matrix in a JSON file, as the alignment writes it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from clradar.errors import ModelError
from clradar.files.failures import fail, reading
from clradar.files.json_file import read_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.model import checks
from measurement_io.maroon.alignment import MESH_SOURCE, read_alignment


def read_transform(path: str | os.PathLike[str]) -> np.ndarray:
    """Return the 4 x 4 matrix of a JSON file, shape (4, 4), float64.

    The file holds four rows of four numbers or sixteen numbers in that order, in metres, or an
    object whose "transform" is one of the two. Of the `alignment.json` of a recording it is the
    matrix that moves the recording's own meshes into the antenna frame.

    Examples
    --------
    >>> from pathlib import Path
    >>> from measurement_io import read_transform
    >>> _ = Path("motion.json").write_text(
    ...     '{"transform": [[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}'
    ... )
    >>> (read_transform("motion.json") @ [1, 0, 0, 1])[:3].tolist()
    [0.1, 1.0, 0.0]
    """
    path = Path(path)
    expected = "a JSON file with a 4 x 4 matrix, or an object with one as 'transform'"
    value = read_json(path, expected, MAX_SMALL_JSON_BYTES)
    with reading(path, expected):
        if isinstance(value, dict) and any(MESH_SOURCE in str(key).split("2") for key in value):
            return read_alignment(path).to_antenna(MESH_SOURCE)
        if isinstance(value, dict):
            if "transform" not in value:
                fail(path, expected, f"an object with {sorted(value)[:10]}")
            value = value["transform"]
        matrix = np.array(value, dtype=np.float64)
        if matrix.shape == (16,):
            matrix = matrix.reshape(4, 4)
        if matrix.shape != (4, 4):
            fail(path, expected, f"numbers of shape {matrix.shape}")
    try:
        return checks.transform("transform", matrix)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error

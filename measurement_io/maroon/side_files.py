"""Records of `metadata.json` and `alignment.json`; both may have keys that nothing here reads."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, create_model

from clradar.errors import ModelError
from clradar.files.failures import clean
from clradar.files.records import FileRecord, Number, Rows, mistake, record_of
from clradar.model import checks

__all__ = ["MetadataFile", "record_of", "transforms_model"]

LAST_ROW_ROUNDING = 1e-9
"""How far the last row of a matrix may be from 0 0 0 1, for matrices that were multiplied."""


class _Kept(FileRecord):
    """A table whose other keys are kept."""

    model_config = ConfigDict(extra="allow", protected_namespaces=())


class BoxTable(_Kept):
    """`mask_bb`."""

    xmin: Number | None = None
    xmax: Number | None = None
    ymin: Number | None = None
    ymax: Number | None = None
    zmin: Number | None = None
    zmax: Number | None = None


class MetadataFile(_Kept):
    """`metadata.json`."""

    calibration: Any = None
    calibration_fine: Any = None
    distance_meters: Annotated[Number, Field(gt=0)] | None = None
    mask_erosion: Any = None
    labels: Any = None
    mask_bb: BoxTable | None = None
    empty_measurement: str | None = Field(None, description="a name")


def transforms_model(keys: Iterable[str]) -> type[FileRecord]:
    """Return the model of an `alignment.json` with these transforms."""
    fields: dict[str, Any] = {key: (Annotated[Rows, AfterValidator(_matrix)], ...) for key in keys}
    return create_model("TransformsFile", __base__=_Kept, **fields)


def _matrix(rows: Any) -> np.ndarray:
    matrix = np.array(rows, dtype=np.float64)
    if matrix.shape != (4, 4):
        raise mistake("four rows of four numbers", f"shape {matrix.shape}")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() <= LAST_ROW_ROUNDING:
        matrix[3] = (0, 0, 0, 1)
    try:
        return checks.transform("it", matrix)
    except ModelError as error:
        raise mistake("an invertible affine transform", clean(error)) from error

"""Metadata of a recording, `metadata.json`: distance, box around the object, labels."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field

from clradar.files.json_file import read_json_object
from clradar.files.records import FileRecord, Number, record_of

DISTANCE_FOLDERS = ("30", "40", "50")
"""Names of distance folders that are a distance in centimetres."""

DISTANCE_TOLERANCE_M = 0.02
"""How far `distance_meters` may be from the folder's name: the name is a round number."""


def _key_of(field: str) -> str:
    return field.removesuffix("_m").replace("_", "")


class MaskBox(FileRecord):
    """A box along the axes, metres, as the file has it; None where there is no bound."""

    model_config = ConfigDict(extra="allow", alias_generator=_key_of, populate_by_name=True)

    x_min_m: Number | None = None
    x_max_m: Number | None = None
    y_min_m: Number | None = None
    y_max_m: Number | None = None
    z_min_m: Number | None = None
    z_max_m: Number | None = None


class RecordingMetadata(FileRecord):
    """The content of `metadata.json`; other keys are in `model_extra`.

    Attributes
    ----------
    calibration, calibration_fine, mask_erosion, labels : JSON value, optional
        As the file has them; their form is not specified.
    distance_meters : float, optional
        Of the object.
    mask_bb : MaskBox, optional
        Box around the object in radar space, in which x is mirrored.
    empty_measurement : str, optional
        Name of the capture of the empty room.
    """

    model_config = ConfigDict(extra="allow")

    calibration: Any = None
    calibration_fine: Any = None
    distance_meters: Annotated[Number, Field(gt=0)] | None = None
    mask_erosion: Any = None
    labels: Any = None
    mask_bb: MaskBox | None = None
    empty_measurement: str | None = Field(None, description="a name")

    @property
    def mask_bb_antenna(self) -> MaskBox | None:
        """The box in the antenna frame."""
        box = self.mask_bb
        if box is None:
            return None
        low, high = (None if x is None else -x for x in (box.x_max_m, box.x_min_m))
        return box.model_copy(update={"x_min_m": low, "x_max_m": high})

    def distance_problem(self, folder_name: str) -> str | None:
        """How the distance contradicts a folder's name 30, 40 or 50; None if it does not."""
        if self.distance_meters is None or folder_name not in DISTANCE_FOLDERS:
            return None
        if abs(self.distance_meters - int(folder_name) / 100) <= DISTANCE_TOLERANCE_M:
            return None
        return (
            f"metadata.json has a distance of {self.distance_meters:g} m, the folder's name "
            f"{folder_name} cm"
        )


def read_metadata(path: str | os.PathLike[str]) -> RecordingMetadata:
    """Read a `metadata.json`.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("metadata.json").write_text('{"mask_bb": {"xmin": -0.2, "xmax": 0.1}}')
    >>> measurement_io.read_metadata("metadata.json").mask_bb_antenna.x_max_m  # x changes sign
    0.2
    """
    return record_of(read_json_object(Path(path)), RecordingMetadata, Path(path))

"""Metadata of a recording, `metadata.json`: distance, box around the object, labels."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.failures import reading
from clradar.files.json_file import read_json_object
from clradar.model import checks

DISTANCE_FOLDERS = ("30", "40", "50")
"""Names of distance folders that are a distance in centimetres."""

DISTANCE_TOLERANCE_M = 0.02
"""How far `distance_meters` may be from the folder's name: the name is a round number."""

_BOUNDS = ("xmin", "xmax", "ymin", "ymax", "zmin", "zmax")


@dataclass(frozen=True, slots=True)
class MaskBox:
    """A box along the axes, each bound in metres or None where there is none.

    The bounds are kept as the file has them, even where a minimum is above its maximum.

    Examples
    --------
    >>> from measurement_io import MaskBox
    >>> box = MaskBox(x_min_m=-0.2, x_max_m=0.1)
    >>> box.x_max_m, box.z_min_m
    (0.1, None)
    """

    x_min_m: float | None = None
    x_max_m: float | None = None
    y_min_m: float | None = None
    y_max_m: float | None = None
    z_min_m: float | None = None
    z_max_m: float | None = None

    def mirrored(self) -> MaskBox:
        """Return the box under x -> -x: from radar space to the antenna frame, or back."""
        return MaskBox(
            None if self.x_max_m is None else -self.x_max_m,
            None if self.x_min_m is None else -self.x_min_m,
            self.y_min_m,
            self.y_max_m,
            self.z_min_m,
            self.z_max_m,
        )

    @property
    def bounds_m(self) -> tuple[tuple[float | None, float | None], ...]:
        """(minimum, maximum) along x, y and z, as the file has them."""
        return (
            (self.x_min_m, self.x_max_m),
            (self.y_min_m, self.y_max_m),
            (self.z_min_m, self.z_max_m),
        )

    @property
    def reversed_axes(self) -> tuple[str, ...]:
        """Axes whose minimum is above their maximum."""
        return tuple(
            axis
            for axis, (low, high) in zip("xyz", self.bounds_m, strict=True)
            if low is not None and high is not None and low > high
        )

    def contains(self, points_m: np.ndarray) -> np.ndarray:
        """Return which points lie in the box, shape (n,), bool.

        A missing bound does not limit; bounds the wrong way round are taken the other way round.

        Parameters
        ----------
        points_m : ndarray, shape (n, 3), metres
            In the frame of the box.
        """
        points = np.asarray(points_m, dtype=np.float64)
        inside = np.ones(len(points), dtype=bool)
        for axis, (low, high) in enumerate(self.bounds_m):
            if low is not None and high is not None and low > high:
                low, high = high, low
            if low is not None:
                inside &= points[:, axis] >= low
            if high is not None:
                inside &= points[:, axis] <= high
        return inside


@dataclass(frozen=True, slots=True)
class RecordingMetadata:
    """The content of `metadata.json`.

    Parameters
    ----------
    calibration, calibration_fine, mask_erosion, labels : JSON value, optional
        As the file has them, lists as tuples; None where the file has none. Their form is
        not specified.
    distance_meters : float, optional, metres
        Distance of the object.
    mask_bb : MaskBox, optional
        Box around the object in radar space, in which x is mirrored.
    empty_measurement : str, optional
        Name of the capture of the empty room.
    other : mapping
        The file's other keys; under "mask_bb" the keys of that which are no bounds.

    Examples
    --------
    >>> from measurement_io import MaskBox, RecordingMetadata
    >>> metadata = RecordingMetadata(distance_meters=0.3, mask_bb=MaskBox(x_min_m=-0.2))
    >>> metadata.mask_bb_antenna.x_max_m  # x changes sign
    0.2
    """

    calibration: Any = None
    calibration_fine: Any = None
    distance_meters: float | None = None
    mask_erosion: Any = None
    labels: Any = None
    mask_bb: MaskBox | None = None
    empty_measurement: str | None = None
    other: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "other", checks.frozen_mapping("other", self.other))

    @property
    def mask_bb_antenna(self) -> MaskBox | None:
        """The box in the antenna frame."""
        return None if self.mask_bb is None else self.mask_bb.mirrored()

    def distance_problem(self, folder_name: str) -> str | None:
        """Return how the distance contradicts a folder's name 30, 40 or 50; None if it does not."""
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
    >>> from measurement_io import read_metadata
    >>> _ = Path("metadata.json").write_text(
    ...     '{"distance_meters": 0.3, "mask_bb": {"xmin": -0.2, "xmax": 0.1}}'
    ... )
    >>> metadata = read_metadata("metadata.json")
    >>> metadata.distance_meters
    0.3
    """
    from measurement_io.maroon.side_files import MetadataFile, record_of

    found = record_of(read_json_object(Path(path)), MetadataFile, Path(path))
    other = dict(found.model_extra or {})
    box = None
    if found.mask_bb is not None:
        box = MaskBox(*(getattr(found.mask_bb, name) for name in _BOUNDS))
        more = found.mask_bb.model_extra
        other |= {"mask_bb": more} if more else {}
    as_is = ("calibration", "calibration_fine", "mask_erosion", "labels")
    kept = {key: tuple(v) if isinstance(v := getattr(found, key), list) else v for key in as_is}
    with reading(path, "the metadata of a recording"):
        return RecordingMetadata(
            **kept, distance_meters=found.distance_meters, mask_bb=box,
            empty_measurement=found.empty_measurement, other=other,
        )  # fmt: skip

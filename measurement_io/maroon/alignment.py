"""The transforms between the sensors of a recording, `alignment.json`.

A key "<a>2<b>" holds the row-major 4 x 4 matrix T of p_b = T p_a. Radar and photogrammetry are in
metres; the optical sensors in millimetres, so their matrices carry a scale. "radar" is the mirrored
radar space of the recording: p_radar = diag(-1, 1, 1) p_antenna.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from clradar.files.failures import clean, fail, reading, shown
from clradar.files.json_file import read_json_object
from clradar.model import checks

RADAR = "radar"
MESH_SOURCE = "photogrammetry"
"""The frame of reference of a recording's meshes."""

MIRROR_X = np.diag([-1.0, 1.0, 1.0, 1.0])
"""Radar space to antenna frame, and back."""
MIRROR_X.flags.writeable = False

CONTRADICTION_M = 1e-4
"""Two ways from one frame to another that differ by more than this contradict each other: a
fortieth of the wavelength at 75 GHz, and more than the rounding of matrices with five decimals."""

_NAME = re.compile("[A-Za-z][A-Za-z0-9_-]*")

# Corners of the space in front of the radar in which two transforms are compared.
_WORKSPACE_M = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.2, 0.6)])


@dataclass(frozen=True, slots=True, eq=False)
class SensorAlignment:
    """The transforms of one `alignment.json`.

    Parameters
    ----------
    path : str
        The file, for messages.
    given : mapping of (source, target) to ndarray, shape (4, 4), float64, read-only
        The transforms that the file holds: p_target = T p_source.
    unknown_keys : tuple of str
        Keys of the file that are no transforms, and were not read.

    Examples
    --------
    >>> import numpy as np
    >>> from measurement_io import SensorAlignment
    >>> matrix = np.diag([0.001, 0.001, 0.001, 1.0])  # of millimetres
    >>> alignment = SensorAlignment("alignment.json", {("kinect", "radar"): matrix})
    >>> alignment.to_antenna("kinect").diagonal().tolist()  # x mirrored
    [-0.001, 0.001, 0.001, 1.0]
    """

    path: str
    given: Mapping[tuple[str, str], np.ndarray]
    unknown_keys: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        given = {}
        for (source, target), matrix in self.given.items():
            given[source, target] = checks.transform(f"{self.path}: {source}2{target}", matrix)
        object.__setattr__(self, "given", MappingProxyType(given))

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the frames of reference that the file knows, sorted."""
        return tuple(sorted({name for pair in self.given for name in pair}))

    def transform(self, source: str, target: str) -> np.ndarray:
        """Return the 4 x 4 matrix from `source` to `target`, in the units of the two.

        The file's own "<source>2<target>" if it is there; else by way of the radar,
        inv(<target>2radar) <source>2radar; else the inverse of "<target>2<source>". A transform
        to or from the radar may itself be given by its inverse.

        Parameters
        ----------
        source, target : str
            Names as in the file: "radar" (metres, mirrored in x), "photogrammetry" (metres),
            "kinect", "zed", "realsense" (millimetres).

        Returns
        -------
        ndarray, shape (4, 4), float64
        """
        checks.text("SensorAlignment.transform: source", source)
        checks.text("SensorAlignment.transform: target", target)
        if source == target:
            return np.eye(4)
        if (source, target) in self.given:
            return self.given[source, target].copy()
        composed = self._through_radar(source, target)
        if composed is not None:
            return composed
        if (target, source) in self.given:
            return np.linalg.inv(self.given[target, source])
        there = ", ".join(f"{a}2{b}" for a, b in sorted(self.given)) or "no transform"
        fail(self.path, f"a way from '{clean(source)}' to '{clean(target)}'", clean(there))

    def to_antenna(self, source: str) -> np.ndarray:
        """Return the 4 x 4 matrix from `source` to the antenna frame, metres.

        diag(-1, 1, 1, 1) <source>2radar. Its determinant is negative for a source that is not
        mirrored itself: turn the winding of a mesh's faces when it is moved by it.
        """
        return MIRROR_X @ self.transform(source, RADAR)

    def problems(self) -> list[str]:
        """Return the contradictions between transforms of the file, with their size."""
        found = []
        for (a, b), matrix in sorted(self.given.items()):
            if a == b:
                found.append(self._difference(a, matrix, f"{a}2{a}", "no change"))
                continue
            if a < b and (b, a) in self.given:
                there_and_back = self.given[b, a] @ matrix
                found.append(self._difference(a, there_and_back, f"{a}2{b}", f"{b}2{a}"))
            composed = None if RADAR in (a, b) else self._through_radar(a, b)
            if composed is not None:
                there_and_back = np.linalg.inv(composed) @ matrix
                way = f"the way from {a} to {b} by the radar"
                found.append(self._difference(a, there_and_back, f"{a}2{b}", way))
        return [line for line in found if line is not None]

    def _given_or_inverse(self, source: str, target: str) -> np.ndarray | None:
        """Return the matrix to or from the radar, None if neither it nor its inverse is given."""
        if source == target:
            return np.eye(4)
        if (source, target) in self.given:
            return self.given[source, target]
        if (target, source) in self.given:
            return np.linalg.inv(self.given[target, source])
        return None

    def _through_radar(self, source: str, target: str) -> np.ndarray | None:
        there, onwards = (
            self._given_or_inverse(source, RADAR),
            self._given_or_inverse(RADAR, target),
        )
        return None if there is None or onwards is None else onwards @ there

    def _difference(self, frame: str, matrix: np.ndarray, one: str, other: str) -> str | None:
        """Return by how much a matrix from `frame` to itself, which should change nothing, moves
        the space in front of the radar; None if by less than `CONTRADICTION_M`.
        """
        to_radar = self._given_or_inverse(frame, RADAR)
        if to_radar is None:  # neither its unit nor the place of the radar is known
            apart = _moved(matrix, _WORKSPACE_M) - _WORKSPACE_M
        else:
            points = _moved(np.linalg.inv(to_radar), _WORKSPACE_M)
            apart = _moved(to_radar, _moved(matrix, points)) - _WORKSPACE_M
        largest = float(np.linalg.norm(apart, axis=1).max())
        if largest <= CONTRADICTION_M:
            return None
        size = f"{largest:.3g} units of {frame}" if to_radar is None else f"{1e3 * largest:.3g} mm"
        return f"{self.path}: {one} and {other} differ, by up to {size}"


def read_alignment(path: str | os.PathLike[str]) -> SensorAlignment:
    """Return the transforms of an `alignment.json`.

    Keys that are not of the form "<a>2<b>" are listed in `unknown_keys` and not read. A transform
    that is null is one that is not there.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> from measurement_io import read_alignment
    >>> matrix = [[0.001, 0, 0, 0.1], [0, 0.001, 0, 0], [0, 0, 0.001, 0], [0, 0, 0, 1]]
    >>> _ = Path("alignment.json").write_text(json.dumps({"kinect2radar": matrix}))
    >>> alignment = read_alignment("alignment.json")
    >>> (alignment.transform("kinect", "radar") @ [200, 0, 300, 1])[:3].round(3).tolist()
    [0.3, 0.0, 0.3]
    """
    path = Path(path)
    from measurement_io.maroon.side_files import record_of, transforms_model

    content = read_json_object(path)
    pairs = {key: _pair(key) for key, value in content.items() if value is not None}
    known = {key: pair for key, pair in pairs.items() if pair is not None}
    found = record_of(content, transforms_model(known), path)
    given = {pair: getattr(found, key) for key, pair in known.items()}
    unknown = tuple(clean(key) for key in content if key not in known)
    with reading(path, "transforms between sensors"):
        return SensorAlignment(shown(path), given, unknown)


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


def stretches(matrix: np.ndarray) -> np.ndarray:
    """Return by how much a transform stretches along its three principal directions, largest first.

    All 1 for a rigid transform, all 0.001 for a rigid one that turns millimetres into metres.
    """
    return np.linalg.svd(matrix[:3, :3], compute_uv=False)


def named_transforms(alignment: SensorAlignment) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name as in the file and the matrix of every given transform, sorted."""
    for (source, target), matrix in sorted(alignment.given.items()):
        yield f"{source}2{target}", matrix


def _moved(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]

"""The poses known by name: the static letters of the ASL alphabet, the digits, an open hand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path

from clradar.hand.pose import HandPose
from clradar.hand.pose_file import parse_pose
from clradar.model import checks

LETTERS: tuple[str, ...] = tuple("ABCDEFGHIKLMNOPQRSTUVWXY")
"""The letters of the American manual alphabet that stand still: all but J and Z."""

DIGITS: tuple[str, ...] = tuple("0123456789")


class _PackagedPoses(Mapping[str, HandPose]):
    """Poses of the files in clradar/hand/poses, each read when it is first asked for."""

    _NAMES = ("flat", *LETTERS, *DIGITS)

    def __getitem__(self, name: str) -> HandPose:
        if name not in self._NAMES:
            raise KeyError(name)
        return _packaged(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._NAMES)

    def __len__(self) -> int:
        return len(self._NAMES)


@cache
def _packaged(name: str) -> HandPose:
    file = resources.files("clradar.hand").joinpath("poses").joinpath(f"{name}.toml")
    return parse_pose(file.read_bytes(), Path(str(file)))


POSES: Mapping[str, HandPose] = _PackagedPoses()
"""Poses by name: `flat` (open hand), letters of the American manual alphabet, digits."""


def pose_by_name(name: str) -> HandPose:
    """Return a pose of `POSES`; upper and lower case mean the same.

    Raises
    ------
    ModelError
        If there is no pose of that name.
    """
    wanted = checks.text("pose", name).strip().casefold()
    for known in POSES:
        if known.casefold() == wanted:
            return POSES[known]
    checks.fail("pose", "one of " + ", ".join(repr(known) for known in POSES), repr(name))

"""Poses by name: an open hand, the static letters of the American manual alphabet, the digits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path

from clradar.files.toml_file import nearest, parse_toml
from clradar.hand.pose import HandPose
from clradar.hand.pose_file import pose_of_table
from clradar.model import checks

LETTERS: tuple[str, ...] = tuple("ABCDEFGHIKLMNOPQRSTUVWXY")
"""The static letters of the American manual alphabet: all but J and Z, which are movements."""

DIGITS: tuple[str, ...] = tuple("0123456789")


class _PackagedPoses(Mapping[str, HandPose]):
    """Poses of ``poses.toml``, which is read at the first use of one."""

    _NAMES = ("flat", *LETTERS, *DIGITS)

    def __getitem__(self, name: str) -> HandPose:
        return _packaged()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._NAMES)

    def __len__(self) -> int:
        return len(self._NAMES)


@cache
def _packaged() -> dict[str, HandPose]:
    file = resources.files("clradar.hand").joinpath("poses.toml")
    tables = parse_toml(file.read_text("utf-8"))
    return {k: pose_of_table({"name": k, **v}, Path(str(file))) for k, v in tables.items()}


POSES: Mapping[str, HandPose] = _PackagedPoses()
"""Poses by name: `flat` (open hand), letters of the American manual alphabet, digits."""


def pose_by_name(name: str) -> HandPose:
    """Return a pose of `POSES`; in upper or lower case.

    Examples
    --------
    >>> from clradar.hand import pose_by_name
    >>> pose = pose_by_name("f")
    >>> pose.name, round(pose.angles("index-finger-phalanx-intermediate").degrees()[0])
    ('F', 79)
    """
    wanted = checks.text("pose", name).strip().casefold()
    for known in POSES:
        if known.casefold() == wanted:
            return POSES[known]
    got = f"{name!r}{nearest(name, tuple(POSES))}"
    checks.fail("pose", "one of " + ", ".join(repr(known) for known in POSES), got)

"""What sweeps over alpha and over roughness share."""

from __future__ import annotations

from collections.abc import Iterable, MutableMapping
from dataclasses import fields
from hashlib import sha256
from typing import Any, ClassVar

import numpy as np
from pydantic_core import to_json

from calibration.roughness.regions import Regions
from clradar.errors import CompareError, warn
from clradar.model import Scene, checks
from clradar.model.record import plain

SEEDS = 3
WHOLE = "all"

Table = tuple[tuple[str, ...], list[list[Any]]]  # names of columns, and rows
LIMITS = ("median", "low", "high", "low95", "high95")  # of an `Interval`, in tables

Store = MutableMapping[str, dict[str, np.ndarray]]  # finished images: name -> arrays


class Estimates:
    """What the results of both sweeps have: `estimates` of the quantity that is `wanted`."""

    __slots__ = ()

    wanted: ClassVar[str]
    drawn: ClassVar[tuple[str, ...]] = ()  # fields that are images
    estimates: tuple[Any, ...]

    def remarks(self) -> tuple[str, ...]:
        """Reasons to doubt the estimates, one clause each."""
        # One value for the whole mesh is none of several regions'.
        own = [one for one in self.estimates if one.name != WHOLE] or self.estimates
        return tuple(f"{self._name_of(one)}: {text}" for one in own for text in one.remarks())

    def _name_of(self, one: Any) -> str:
        return self.wanted if one.name == WHOLE else f"{self.wanted} of {one.name}"

    def report(self) -> str:
        """The estimates and their caveats as text."""
        lines = []
        for one in self.estimates:
            lines += [f"{self._name_of(one)}: {one.text()}", *(f"  {r}" for r in one.remarks())]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """All numbers in types that strict JSON has; None stands for NaN."""
        own: Any = self
        shown = (f.name for f in fields(own) if f.name not in (*self.drawn, "estimates"))
        estimates = {one.name: {"text": one.text(), **plain(one)} for one in self.estimates}
        return {**plain({name: getattr(self, name) for name in shown}), "estimates": estimates}

    def warn(self) -> None:
        for remark in self.remarks():
            warn(f"sweep: {remark}")


def fingerprint(*values: Any) -> str:
    """Return what names of images begin with: other arguments make others."""

    def plain(one: Any) -> Any:  # lists of numbers would take a second for 300 000 faces
        return (one.dtype.str, one.shape, one.tobytes()) if hasattr(one, "tobytes") else repr(one)

    return sha256(to_json(values, bytes_mode="base64", fallback=plain)).hexdigest()[:12]


def check_regions(function: str, regions: Regions | None, scene: Scene) -> tuple[str, ...]:
    """Return the names of the regions, none of the whole mesh."""
    if regions is None:
        return ()
    checks.instance(f"{function}: regions", regions, Regions)
    if len(regions.face) != scene.n_faces:
        checks.fail(f"{function}: regions", f"{scene.n_faces} faces", f"{len(regions.face)}")
    return regions.names


def estimable(what: str, names: Iterable[str], meters: Iterable[Any]) -> None:
    """Raise `CompareError` unless enough of each region is visible."""
    for name, meter in zip(names, meters, strict=True):
        if not meter.bins:
            raise CompareError(
                f"sweep: region '{name}' is too small, or too steep, to tell its {what}: only "
                f"{meter.n_points} points of it are visible"
            )

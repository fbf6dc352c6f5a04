"""Options of an image over several seeds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from clradar.cli.options.groups import given, option
from clradar.cli.options.values import wrong_usage


@dataclass(frozen=True, kw_only=True)
class SeedOptions:
    """Error bars: the same simulation with other seeds."""

    seeds: int | None = option(
        None,
        "Repeat the simulation of CAPTURE with so many seeds: -o gets the mean image, --png mean, "
        "standard deviation, and profiles with a band.",
        min=2,
        metavar="N",
    )
    mesh: list[Path] | None = option(
        None,
        "With --seeds: a mesh of the simulation, in its order; may be repeated. [default: of the "
        "same name beside CAPTURE, or here]",
        metavar="MESH",
    )
    snr_db: float | None = option(
        None, "With --seeds: add noise of this signal-to-noise ratio to each.", metavar="DB"
    )

    def __post_init__(self) -> None:
        if self.seeds is None:
            for name in given(self):
                raise wrong_usage(name, "expected together with --seeds")

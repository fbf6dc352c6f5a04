"""Options of an image: how it is formed, and what is written of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import clradar as cl
from clradar.cli import parse
from clradar.cli.groups import given, option, output_option, written, wrong_usage
from clradar.cli.options.measured import (
    ITERATED,
    METHODS,
    GridOptions,
    ImagingOptions,
    PictureOptions,
)
from clradar.errors import MeasurementError


@dataclass(frozen=True, kw_only=True)
class ImageFiles(PictureOptions):
    """Files of an image, one of which has to be written."""

    output: Path | None = output_option("Volume to write (HDF5).")
    png: Path | None = written(
        "Draw amplitude and depth: .png, .pdf or .svg.", "--png", "--figure", check=parse.figure
    )
    report: Path | None = written(
        "Page: figure, 3-D view, facts and settings in one .html file.", check=parse.page
    )
    dbsm: bool = option(
        "Draw radar cross sections in dBsm, of S-parameters.",
        False,
        without=ITERATED,
        kept=False,
    )


@dataclass(frozen=True, kw_only=True)
class ImageOptions(GridOptions, ImagingOptions):
    """How an image is formed, also by iteration, and where."""

    # A wider choice than that of the other commands.
    method: Literal["fast", "range", "exact", "least-squares", "sparse"] = option(  # type: ignore[assignment]
        f"{METHODS} By iteration (needs pylops): least-squares, or sparse, of few voxels.",
        "fast",
    )
    iterations: int | None = option(
        "At most, of an image by iteration. [default: 30, sparse 100]",
        metavar="N",
        min=1,
        needs=ITERATED,
    )
    damping_db: float | None = option(
        "Of least-squares: weight of the power. [default: none]", needs="--method=least-squares"
    )
    sparsity_db: float | None = option(
        "Of sparse: threshold below the maximum. [default: -30]", needs="--method=sparse"
    )
    everything: bool = option(
        "Without a grid: one around all echoes up to 25 dB below the strongest.",
        False,
        "--all-echoes",
        without="--x-mm --y-mm --z-mm",
    )
    tolerance_db: float | None = option(
        "Error of fast and by iteration, RMS over RMS, -80 to -30. [default: -50]"
    )
    absolute: bool = option("The samples are S-parameters.", False)

    @property
    def iterated(self) -> bool:
        """Whether it is formed by iteration: by `clradar.reconstruct`."""
        return self.method in ("least-squares", "sparse")

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`, or of `clradar.reconstruct`."""
        names = ("iterations", "damping_db", "sparsity_db") if self.iterated else ("window",)
        return {name: getattr(self, name) for name in ("method", "tolerance_db", *names)}

    def check(
        self,
        content: cl.Capture | cl.Volume,
        captures: list[Path],
        files: ImageFiles,
        others: Mapping[str, Any],
    ) -> None:
        """Raise where an option has no meaning for what is read."""
        several, volume = len(captures) > 1, isinstance(content, cl.Volume)
        if several and volume:
            raise wrong_usage("CAPTURE", f"expected captures, got the volume {captures[0]}")
        wrong = {"--method": self.iterated, "--dbsm": files.dbsm, "--absolute": self.absolute}
        if several and any(wrong.values()):
            name = next(name for name, is_wrong in wrong.items() if is_wrong)
            raise wrong_usage(name, "expected with a single capture, not with several")
        if files.dbsm and not (self.absolute or content.absolute):
            raise MeasurementError(
                f"{captures[0]}: expected S-parameters for --dbsm, got samples on a relative "
                "scale; --absolute says that they are S-parameters"
            )
        chosen = {**given(self), "-o": files.output, **others}
        names = [name for name, value in chosen.items() if value is not None]
        if volume and names:
            raise wrong_usage(names[0], "the input is a volume, which is an image already")

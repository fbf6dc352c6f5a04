"""Options of a sweep: alphas, or roughness in millimetres, and the regions of the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli import parse
from clradar.cli.groups import option, wrong_usage
from clradar.cli.options.scene import PHYSICAL
from clradar.constants import PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.errors import CompareError, warn
from clradar.model import checks

if TYPE_CHECKING:
    from calibration import Regions, RoughnessSweep, Sweep
    from clradar.cli.inputs import Measurement


@dataclass(frozen=True, kw_only=True)
class AlphaOptions:
    """The alphas and the seeds to simulate with."""

    alpha: tuple[float, ...] = option(
        f"{parse.RANGE_RULE}, or a list with commas; in [0, 1].",
        "0:1:0.1",
        metavar="RANGE",
        without="--roughness-mm",
        parse=parse.ascending("alphas", (0.0, 1.0), least=2),
    )
    seeds: int = option(
        "Simulations per alpha, each its own seed.",
        3,
        check=partial(checks.whole, low=1),
    )
    seed: int = option("The first seed.", 0)

    estimator = None

    def sweep(
        self, measured: Measurement, scene: cl.Scene, images: Mapping[str, Any], **how: Any
    ) -> Sweep:
        """Sweep over alpha; `images` and `how` as of `calibration.sweep`."""
        import calibration

        window = images["window"]
        own = measured.content.meta.get("window", window)
        if own != window and isinstance(measured.content, cl.Volume):
            warn(
                f"{measured.path}: was formed with the window '{own}'; simulations are with "
                f"'{window}' (--window)"
            )
        return calibration.sweep(
            measured.volume, scene, np.array(self.alpha), **measured.radar, **images, **how
        )


def _lengths_mm(noun: str, bounds_m: tuple[float, float]) -> Any:
    return parse.ascending(noun, (1e3 * bounds_m[0], 1e3 * bounds_m[1]))


@dataclass(frozen=True, kw_only=True)
class RoughnessOptions:
    """Roughness and correlation lengths to simulate with, in place of alphas."""

    roughness_mm: tuple[float, ...] | None = option(
        "In place of --alpha: RMS heights of the surface, at least three; heights times lengths "
        "times --seeds are 30 or more; as --alpha. Try 0.1:0.6:0.1.",
        metavar="RANGE",
        parse=_lengths_mm("heights", PLAUSIBLE_ROUGHNESS_M),
    )
    correlation_mm: tuple[float, ...] = option(
        "Correlation lengths, as above; a single one is taken for known.",
        "1.5,3,6",
        metavar="RANGE",
        needs="--roughness-mm",
        parse=_lengths_mm("lengths", PLAUSIBLE_CORRELATION_M),
    )
    calibrated: bool = option(
        "MEASURED is in S-parameters, and its level counts.", False, needs="--roughness-mm"
    )

    estimator = PHYSICAL

    def sweep(
        self, measured: Measurement, scene: cl.Scene, images: Mapping[str, Any], **how: Any
    ) -> RoughnessSweep:
        """Sweep over roughness and correlation length; whole `images` are not formed."""
        import calibration

        if isinstance(measured.content, cl.Volume):
            raise CompareError(
                f"{measured.path}: expected a capture with --roughness-mm, got a volume: roughness "
                "is estimated from images by parts of the aperture"
            )
        lengths_m = (np.array(mm) / 1e3 for mm in (self.roughness_mm, self.correlation_mm))
        return calibration.sweep_roughness(
            measured.content, scene, *lengths_m, calibrated=self.calibrated, **how
        )


PARTS, FINGERS = "parts", "fingers"


def _region_file(regions: str) -> list[Path]:
    return [] if regions in (PARTS, FINGERS) else [Path(regions)]


@dataclass(frozen=True, kw_only=True)
class RegionOptions:
    """Regions of the mesh that have an alpha each."""

    regions: str | None = option(
        "Find an alpha for each named part, for fingers and palm, or for the regions of a file: "
        ".npy or .json with a label per face, or .json with region: [parts].",
        metavar="parts|fingers|FILE",
        files=_region_file,
    )

    def read(self, scene: cl.Scene, max_bounces: int = 1) -> Regions | None:
        """The regions of a mesh."""
        from calibration import Regions

        if self.regions is None:
            return None
        if max_bounces > 1:
            text = "expected 1 with --regions: a path of two bounces belongs to no single region"
            raise wrong_usage("--max-bounces", text)
        known = {PARTS: Regions.of_parts, FINGERS: Regions.of_fingers}
        return known.get(self.regions, partial(Regions.read, Path(self.regions)))(scene)

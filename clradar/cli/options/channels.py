"""Options of ``clradar channels``: the known target, and the estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.options.groups import REQUIRED, given, option, recorded, wrong_usage
from clradar.cli.parse import numbers_of, position_m

if TYPE_CHECKING:
    from calibration import Target

OPTIONS_OF = {
    "plate": ("--distance-mm", "--tilt-deg", "--size-mm"),
    "sphere": ("--position-mm", "--radius-mm"),
    "corner": ("--position-mm",),
}
"""Options of each kind of target beside `--amplitude`: all but tilt and size are needed."""


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """The known target; each option belongs to some kinds of target only."""

    target: Literal["plate", "sphere", "corner"] = option("Kind of the target.", REQUIRED)
    distance_mm: float | None = option("Plate: distance along z.")
    tilt_deg: str | None = option("Plate: farther away towards +x, +y.", metavar="X,Y")
    size_mm: str | None = option("Plate: width and height. [default: endless]", metavar="W,H")
    position_mm: str | None = option("Sphere: its centre; corner: its apex.", metavar="X,Y,Z")
    radius_mm: float | None = option("Sphere: to a thousandth of it.")
    amplitude: Literal["unit", "spreading"] = option("1 for every pair, or 1/(R1 R2).", "unit")

    def read(self) -> Target:
        """The target that the options describe."""
        import numpy as np

        from calibration import CornerReflector, FlatPlate, Sphere

        own, there = OPTIONS_OF[self.target], given(self)
        for name in own:
            if name not in there and name not in ("--tilt-deg", "--size-mm"):
                raise wrong_usage(name, f"a {self.target} needs it")
        for name in there:
            if name not in (*own, "--target", "--amplitude"):
                raise wrong_usage(name, f"a {self.target} has none")
        if self.distance_mm is not None:
            tilt_deg = numbers_of("--tilt-deg", self.tilt_deg or "0,0", 2)
            size_m = None
            if self.size_mm is not None:
                width_mm, height_mm = numbers_of("--size-mm", self.size_mm, 2)
                size_m = (width_mm / 1e3, height_mm / 1e3)
            distance_m = self.distance_mm / 1e3
            return FlatPlate(distance_m, *tilt_deg, size_m=size_m, amplitude=self.amplitude)
        place_m = np.array(position_m("--position-mm", str(self.position_mm)))
        if self.radius_mm is not None:
            return Sphere(place_m, self.radius_mm / 1e3, amplitude=self.amplitude)
        return CornerReflector(place_m, amplitude=self.amplitude)


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """How gains and delays are estimated."""

    PANEL = "Expert"

    hold: bool = option("The target is exactly at the position of the options.", False)
    tolerance_mm: float = option("Tolerance of its position, per axis.", 10.0)
    tilt_tolerance_deg: float = option("How well a plate's tilt is known.", 2.0)
    max_delay_ps: float = option("Largest delay of a pair that is searched for.", 100.0)
    common_delay: Literal["zero", "free"] = option("Delays scatter about this.", "zero")
    level: Literal["mean", "target"] = option("0 dB: mean gain, or echo as modelled.", "mean")
    gate_mm: float | None = option("Use echoes within this range of the target only.")
    dead_db: float = option("Dead: this far below the median gain.", 20.0)
    noisy_db: float = option("Noisy: this far above the median noise.", 6.0)
    max_residual_db: float = option("Refuse where more of the echoes is left.", -10.0)

    def settings(self) -> dict[str, Any]:
        """Settings of `calibration.estimate_channels`."""
        found = recorded(self)
        found["refine_position"] = not found.pop("hold")
        found["position_tolerance_m"] = found.pop("tolerance_mm") / 1e3
        found["max_delay_s"] = found.pop("max_delay_ps") / 1e12
        gate_mm = found.pop("gate_mm")
        found["gate_m"] = None if gate_mm is None else gate_mm / 1e3
        return found

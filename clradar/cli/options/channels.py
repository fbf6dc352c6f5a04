"""Options of ``clradar channels``: the known target, and the estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.options.common import Amplitude
from clradar.cli.options.groups import REQUIRED, given, option, recorded, wrong_usage
from clradar.cli.parse import numbers

if TYPE_CHECKING:
    from calibration import Target


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """The known target; each option belongs to some kinds of target only."""

    target: Literal["plate", "sphere", "corner"] = option(REQUIRED, "Kind of the target.")
    distance_mm: float | None = option(None, "Plate: distance along z.")
    tilt_deg: str | None = option(None, "Plate: farther away towards +x, +y.", metavar="X,Y")
    size_mm: str | None = option(None, "Plate: width and height. [default: endless]", metavar="W,H")
    position_mm: str | None = option(None, "Sphere: its centre; corner: its apex.", metavar="X,Y,Z")
    radius_mm: float | None = option(None, "Sphere: to a thousandth of it.")
    amplitude: Amplitude = option("unit", "1 for every pair, or 1/(R1 R2).")

    def read(self) -> Target:
        """The target that the options describe."""
        import numpy as np

        from calibration import CornerReflector, FlatPlate, Sphere

        self._check()
        amplitude = self.amplitude
        if self.distance_mm is not None:
            tilt_x, tilt_y = _numbers(
                "--tilt-deg", "0,0" if self.tilt_deg is None else self.tilt_deg, 2
            )
            size_m = None
            if self.size_mm is not None:
                width_mm, height_mm = _numbers("--size-mm", self.size_mm, 2)
                size_m = (width_mm / 1e3, height_mm / 1e3)
            distance_m = self.distance_mm / 1e3
            return FlatPlate(distance_m, tilt_x, tilt_y, size_m=size_m, amplitude=amplitude)
        place_m = np.array(_numbers("--position-mm", str(self.position_mm), 3)) / 1e3
        if self.radius_mm is not None:
            return Sphere(place_m, self.radius_mm / 1e3, amplitude=amplitude)
        return CornerReflector(place_m, amplitude=amplitude)

    def _check(self) -> None:
        needed, allowed = {
            "plate": (["--distance-mm"], ["--tilt-deg", "--size-mm"]),
            "sphere": (["--position-mm", "--radius-mm"], []),
            "corner": (["--position-mm"], []),
        }[self.target]
        there = given(self)
        for name in needed:
            if name not in there:
                raise wrong_usage(name, f"a {self.target} needs it")
        for name in there:
            if name not in (*needed, *allowed, "--target", "--amplitude"):
                raise wrong_usage(name, f"a {self.target} has none")


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """How gains and delays are estimated."""

    hold: bool = option(False, "The target is exactly at the position of the options.")
    tolerance_mm: float = option(10.0, "Tolerance of its position, per axis.")
    tilt_tolerance_deg: float = option(2.0, "How well a plate's tilt is known.")
    max_delay_ps: float = option(100.0, "Largest delay of a pair that is searched for.")
    common_delay: Literal["zero", "free"] = option("zero", "Delays scatter about this.")
    level: Literal["mean", "target"] = option(
        "mean", "0 dB: the mean gain, or that which echoes as modelled."
    )
    gate_mm: float | None = option(None, "Use echoes within this range of the target only.")
    dead_db: float = option(20.0, "Dead: this far below the median gain.")
    noisy_db: float = option(6.0, "Noisy: this far above the median noise.")
    max_residual_db: float = option(-10.0, "Refuse where more of the echoes is left.")

    def settings(self) -> dict[str, Any]:
        """Settings of `calibration.estimate_channels`."""
        found = recorded(self)
        found["refine_position"] = not found.pop("hold")
        found["position_tolerance_m"] = found.pop("tolerance_mm") / 1e3
        found["max_delay_s"] = found.pop("max_delay_ps") / 1e12
        gate_mm = found.pop("gate_mm")
        found["gate_m"] = None if gate_mm is None else gate_mm / 1e3
        return found


def _numbers(option: str, text: str, count: int) -> list[float]:
    found = numbers(text)
    if len(found) != count:
        raise wrong_usage(option, f"expected {count} numbers with commas between, got '{text}'")
    return found

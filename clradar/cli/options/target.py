"""Options of a known target, and of the channels that are estimated from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli import parse
from clradar.cli.groups import arguments_of, option

if TYPE_CHECKING:
    from calibration.channels.targets import Target


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """The known target; each option belongs to some kinds of target only."""

    target: Literal["plate", "sphere", "corner"] = option("Kind of the target.")
    distance_mm: float | None = option(
        "Plate: distance along z.", needs="--target=plate", due="--target=plate"
    )
    tilt_deg: tuple[float, ...] | None = option(
        "Plate: farther away towards +x, +y.",
        metavar="X,Y",
        needs="--target=plate",
        parse=parse.pair,
    )
    size_mm: tuple[float, ...] | None = option(
        "Plate: width and height. [default: endless]",
        metavar="W,H",
        needs="--target=plate",
        parse=parse.pair,
    )
    position_mm: tuple[float, ...] | None = option(
        "Sphere: its centre; corner: its apex.",
        metavar="X,Y,Z",
        needs="--target=sphere|corner",
        due="--target=sphere|corner",
        parse=parse.position_mm,
    )
    radius_mm: float | None = option(
        "Sphere: to a thousandth of it.", needs="--target=sphere", due="--target=sphere"
    )

    def read(self) -> Target:
        """The target that the options describe."""
        from calibration import CornerReflector, FlatPlate, Sphere

        known = arguments_of(self)
        kinds: Any = {"plate": FlatPlate, "sphere": Sphere, "corner": CornerReflector}
        if tilt_deg := known.pop("tilt_deg", None):
            known |= dict(zip(("tilt_x_deg", "tilt_y_deg"), tilt_deg, strict=True))
        target: Target = kinds[known.pop("target")](**known)
        return target


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """How gains and delays are estimated."""

    PANEL = "Expert"

    hold: bool = option("The target is exactly at the position of the options.", False)
    tolerance_mm: float = option("Tolerance of its position, per axis.", 10.0)
    tilt_tolerance_deg: float = option("How well a plate's tilt is known.", 2.0)
    max_delay_ps: float = option("Largest delay of a pair that is searched for.", 100.0)
    common_delay: Literal["zero", "free"] = option("Delays scatter about this.", "zero")
    gate_mm: float | None = option("Use echoes within this range of the target only.")
    dead_db: float = option("Dead: this far below the median gain.", 20.0)
    noisy_db: float = option("Noisy: this far above the median noise.", 6.0)
    max_residual_db: float = option("Refuse where more of the echoes is left.", -10.0)

    def settings(self) -> dict[str, Any]:
        """Settings of `calibration.estimate_channels`."""
        found = arguments_of(self)
        found["refine_position"] = not found.pop("hold")
        found["position_tolerance_m"] = found.pop("tolerance_m")
        return found

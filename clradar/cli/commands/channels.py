"""``clradar channels``: estimate gain and delay of every channel from a known target."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import clradar as cl
from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli.console import print_line, print_table, progress_bar
from clradar.cli.inputs import title_of
from clradar.cli.outputs import provenance, save

if TYPE_CHECKING:
    from calibration import Target


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """The known target; each option belongs to some kinds of target only."""

    target: Literal["plate", "sphere", "corner"] = opt.option("Kind of the target.", opt.REQUIRED)
    distance_mm: float | None = opt.option(
        "Plate: distance along z.", needs="--target=plate", due="--target=plate"
    )
    tilt_deg: tuple[float, ...] | None = opt.option(
        "Plate: farther away towards +x, +y.",
        metavar="X,Y",
        needs="--target=plate",
        parse=parse.pair,
    )
    size_mm: tuple[float, ...] | None = opt.option(
        "Plate: width and height. [default: endless]",
        metavar="W,H",
        needs="--target=plate",
        parse=parse.pair,
    )
    position_mm: tuple[float, ...] | None = opt.option(
        "Sphere: its centre; corner: its apex.",
        metavar="X,Y,Z",
        needs="--target=sphere|corner",
        due="--target=sphere|corner",
        parse=parse.position_mm,
    )
    radius_mm: float | None = opt.option(
        "Sphere: to a thousandth of it.", needs="--target=sphere", due="--target=sphere"
    )

    def read(self) -> Target:
        """The target that the options describe."""
        from calibration import CornerReflector, FlatPlate, Sphere

        if self.distance_mm is not None:
            width, height = parse.metres(self.size_mm) if self.size_mm else (None, None)
            size_m = None if width is None or height is None else (width, height)
            tilt_deg, distance_m = self.tilt_deg or (0.0, 0.0), self.distance_mm / 1e3
            return FlatPlate(distance_m, *tilt_deg, size_m=size_m)
        place_m = np.array(parse.metres(self.position_mm or ()))
        if self.radius_mm is not None:
            return Sphere(place_m, self.radius_mm / 1e3)
        return CornerReflector(place_m)


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """How gains and delays are estimated."""

    PANEL = "Expert"

    hold: bool = opt.option("The target is exactly at the position of the options.", False)
    tolerance_mm: float = opt.option("Tolerance of its position, per axis.", 10.0)
    tilt_tolerance_deg: float = opt.option("How well a plate's tilt is known.", 2.0)
    max_delay_ps: float = opt.option("Largest delay of a pair that is searched for.", 100.0)
    common_delay: Literal["zero", "free"] = opt.option("Delays scatter about this.", "zero")
    gate_mm: float | None = opt.option("Use echoes within this range of the target only.")
    dead_db: float = opt.option("Dead: this far below the median gain.", 20.0)
    noisy_db: float = opt.option("Noisy: this far above the median noise.", 6.0)
    max_residual_db: float = opt.option("Refuse where more of the echoes is left.", -10.0)

    def settings(self) -> dict[str, Any]:
        """Settings of `calibration.estimate_channels`."""
        found = opt.values_of(self)
        gate_mm = found.pop("gate_mm")
        return {
            "refine_position": not found.pop("hold"),
            "position_tolerance_m": found.pop("tolerance_mm") / 1e3,
            "max_delay_s": found.pop("max_delay_ps") / 1e12,
            "gate_m": None if gate_mm is None else gate_mm / 1e3,
            **found,
        }


def command(
    *,
    capture: Path = opt.argument(
        "Of the target: native capture, recorded .npy frame, or radar folder.",
        opt.REQUIRED,
        metavar="CAPTURE",
    ),
    target: TargetOptions,
    output: Path = opt.output_option("Channels to write (HDF5).", opt.REQUIRED),
    estimate: EstimateOptions,
    plot: Path | None = opt.written(
        "Also draw gains, phases and delays: .png, .pdf or .svg.",
        "--plot",
        "--figure",
        check=parse.figure,
    ),
    frames: opt.FrameOptions,
    force: bool = opt.FORCE,
) -> None:
    """The target's position is refined, too. Which errors are observable:
    docs/channel-calibration.md. The mean of a recording's frames: `clradar clean --average`.
    """
    from calibration import estimate_channels
    from calibration.channels.figure import channels_figure
    from clradar.plot import save_figure

    known = target.read()
    loaded, files = opt.open_frame(capture, frames)
    with progress_bar("fitting channels") as progress:
        channels = estimate_channels(loaded, known, progress=progress, **estimate.settings())
    save(output, channels, provenance(files), force=force)
    print_channels(channels)
    print_line(
        f"{output}: {channels.residual_db:.1f} dB of the echoes is left, "
        f"{channels.noise_residual_db:.1f} dB by noise"
    )
    if plot is not None:
        save_figure(channels_figure(channels, title_of(capture, loaded.meta)), plot, force=force)
        print_line(f"{plot}: gains, phases and delays")


def print_channels(channels: cl.ChannelCalibration) -> None:
    """Print gains and delays of both sides, and the target's position."""
    rows = []
    for side in ("tx", "rx"):
        gain = getattr(channels.response, f"{side}_gain")
        live = gain != 0
        delay_ps = 1e12 * getattr(channels.response, f"{side}_delay_s")[live]
        gain_db = 20 * np.log10(np.abs(gain[live]))
        noise_db = 20 * np.log10(np.median(getattr(channels, f"{side}_noise")[live]) + 1e-30)
        listed = [getattr(channels, f"{state}_{side}").tolist() for state in ("dead", "noisy")]
        rows.append(
            [
                side.title(), f"{gain_db.size} of {gain.size}",
                *(" ".join(map(str, found)) or "none" for found in listed),
                f"{gain_db.min():+.2f} to {gain_db.max():+.2f}", f"{delay_ps.mean():+.2f}",
                f"{delay_ps.min():+.2f} to {delay_ps.max():+.2f}", f"{noise_db:.1f}",
            ]
        )  # fmt: skip
    columns = ("", "live", "dead", "noisy", "gain (dB)", "mean delay (ps)", "delay (ps)")
    print_table([*columns, "noise (dB)"], rows)
    parts = []
    for name, value in channels.target_position.items():
        what, unit = name.rsplit("_", 1)
        scale, shown = (1e3, "mm") if unit == "m" else (1.0, "deg")
        std = scale * channels.target_std[name]
        parts.append(f"{what} {scale * value:.3f} ± {std:.3f} {shown}")
    print_line(f"{channels.target}: {', '.join(parts)}")

"""``clradar channels``."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from clradar.cli.image import check_figure_name
from clradar.cli.images import recording_files
from clradar.cli.options import ForceOption, FrameOption, VariantOption, wrong_usage
from clradar.cli.output import check_outputs, print_line, print_table, print_warning
from clradar.cli.provenance import provenance

if TYPE_CHECKING:
    from calibration import Target
    from clradar import ChannelCalibration

UNEXPLAINED_DB = 10.0
"""A residual this far above what noise leaves is worth a warning."""


class TargetKind(str, Enum):
    """A known target."""

    plate = "plate"
    sphere = "sphere"
    corner = "corner"


class CommonDelay(str, Enum):
    """What the mean of all delays is."""

    zero = "zero"
    free = "free"


class Level(str, Enum):
    """What gains of 0 dB are."""

    mean = "mean"
    target = "target"


class Amplitude(str, Enum):
    """How strong the echo of a pair is."""

    unit = "unit"
    spreading = "spreading"


def command(
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE",
            help="Of the target: native capture, recorded .npy frame, or radar folder.",
        ),
    ],
    target: Annotated[TargetKind, typer.Option("--target", help="What stands there.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Channels to write (HDF5).")],
    distance_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--distance-mm", help="Plate: distance along z."),
    ] = None,
    tilt_deg: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--tilt-deg", metavar="X,Y", help="Plate: farther away towards +x, +y."),
    ] = None,
    size_mm: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--size-mm", metavar="W,H", help="Plate: width and height. [default: endless]"
        ),
    ] = None,
    position_mm: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--position-mm", metavar="X,Y,Z", help="Sphere: its centre; corner: its apex."
        ),
    ] = None,
    radius_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--radius-mm", help="Sphere: to a thousandth of it."),
    ] = None,
    amplitude: Annotated[
        Amplitude, typer.Option("--amplitude", help="1 for every pair, or 1/(R1 R2).")
    ] = Amplitude.unit,
    hold: Annotated[
        bool, typer.Option("--hold", help="The target is where it was said to be, exactly.")
    ] = False,
    tolerance_mm: Annotated[
        float, typer.Option("--tolerance-mm", help="How well its place is known, per axis.")
    ] = 10.0,
    tilt_tolerance_deg: Annotated[
        float, typer.Option("--tilt-tolerance-deg", help="How well a plate's tilt is known.")
    ] = 2.0,
    max_delay_ps: Annotated[
        float, typer.Option("--max-delay-ps", help="Largest delay of a pair that is looked for.")
    ] = 100.0,
    common_delay: Annotated[
        CommonDelay, typer.Option("--common-delay", help="Delays scatter about this.")
    ] = CommonDelay.zero,
    level: Annotated[
        Level,
        typer.Option("--level", help="0 dB: the mean gain, or that which echoes as modelled."),
    ] = Level.mean,
    gate_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--gate-mm", help="Use echoes within this range of the target only."),
    ] = None,
    dead_db: Annotated[
        float, typer.Option("--dead-db", help="Dead: this far below the median gain.")
    ] = 20.0,
    noisy_db: Annotated[
        float, typer.Option("--noisy-db", help="Noisy: this far above the median noise.")
    ] = 6.0,
    max_residual_db: Annotated[
        float, typer.Option("--max-residual-db", help="Refuse where more of the echoes is left.")
    ] = -10.0,
    plot: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--plot", help="Also draw gains, phases and delays: .png, .pdf or .svg."),
    ] = None,
    frame: FrameOption = None,
    variant: VariantOption = None,
    force: ForceOption = False,
) -> None:
    """The target's place is refined, too. What can be told apart: docs/channel-calibration.md."""
    from dataclasses import replace

    from calibration import estimate_channels
    from calibration.channels.figure import channels_figure
    from clradar.plot import save_figure
    from measurement_io import open_capture, save_channels

    known = _target(target, distance_mm, tilt_deg, size_mm, position_mm, radius_mm, amplitude)
    if plot is not None:
        check_figure_name(plot)
    check_outputs([output, plot], force=force, inputs=[capture])
    loaded = open_capture(capture, frame=frame, variant=None if variant is None else variant.value)
    channels = estimate_channels(
        loaded,
        known,
        refine_position=not hold,
        position_tolerance_m=tolerance_mm / 1e3,
        tilt_tolerance_deg=tilt_tolerance_deg,
        max_delay_s=max_delay_ps / 1e12,
        common_delay=common_delay.value,
        level=level.value,
        gate_m=None if gate_mm is None else gate_mm / 1e3,
        dead_db=dead_db,
        noisy_db=noisy_db,
        max_residual_db=max_residual_db,
    )
    options: dict[str, Any] = {
        "target": target.value,
        "distance_mm": distance_mm,
        "tilt_deg": tilt_deg,
        "size_mm": size_mm,
        "position_mm": position_mm,
        "radius_mm": radius_mm,
        "amplitude": amplitude.value,
        "hold": hold,
        "tolerance_mm": tolerance_mm,
        "tilt_tolerance_deg": tilt_tolerance_deg,
        "max_delay_ps": max_delay_ps,
        "common_delay": common_delay.value,
        "level": level.value,
        "gate_mm": gate_mm,
        "dead_db": dead_db,
        "noisy_db": noisy_db,
        "max_residual_db": max_residual_db,
        "frame": frame,
        "variant": None if variant is None else variant.value,
    }
    inputs = recording_files(capture, loaded.meta)
    meta = {**channels.meta, **provenance("channels", options, inputs)}
    save_channels(output, replace(channels, meta=meta), force=force)
    _print_summary(output, channels)
    if plot is not None:
        save_figure(channels_figure(channels, capture.name), plot, force=force)
        print_line(f"{plot}: gains, phases and delays")


def _target(
    kind: TargetKind,
    distance_mm: float | None,
    tilt_deg: str | None,
    size_mm: str | None,
    position_mm: str | None,
    radius_mm: float | None,
    amplitude: Amplitude,
) -> Target:
    """Return the target that the options describe; each option belongs to some kinds only."""
    import numpy as np

    from calibration import CornerReflector, FlatPlate, Sphere

    given = {
        "--distance-mm": distance_mm,
        "--tilt-deg": tilt_deg,
        "--size-mm": size_mm,
        "--position-mm": position_mm,
        "--radius-mm": radius_mm,
    }
    needed, allowed = {
        TargetKind.plate: (["--distance-mm"], ["--tilt-deg", "--size-mm"]),
        TargetKind.sphere: (["--position-mm", "--radius-mm"], []),
        TargetKind.corner: (["--position-mm"], []),
    }[kind]
    for option, value in given.items():
        if value is None and option in needed:
            raise wrong_usage(option, f"a {kind.value} needs it")
        if value is not None and option not in needed + allowed:
            raise wrong_usage(option, f"a {kind.value} has none")
    if distance_mm is not None:
        tilt = _numbers("--tilt-deg", "0,0" if tilt_deg is None else tilt_deg, 2)
        size = None if size_mm is None else _numbers("--size-mm", size_mm, 2)
        return FlatPlate(
            distance_mm / 1e3,
            tilt[0],
            tilt[1],
            size_m=None if size is None else (size[0] / 1e3, size[1] / 1e3),
            amplitude=amplitude.value,
        )
    place_m = np.array(_numbers("--position-mm", str(position_mm), 3)) / 1e3
    if radius_mm is not None:
        return Sphere(place_m, radius_mm / 1e3, amplitude=amplitude.value)
    return CornerReflector(place_m, amplitude=amplitude.value)


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise wrong_usage(option, f"expected {count} numbers with commas between, got '{text}'")
    return numbers


def _print_summary(output: Path, channels: ChannelCalibration) -> None:
    import numpy as np

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
                side.title(),
                f"{gain_db.size} of {gain.size}",
                *(" ".join(map(str, found)) or "none" for found in listed),
                f"{gain_db.min():+.2f} to {gain_db.max():+.2f}",
                f"{delay_ps.mean():+.2f}",
                f"{delay_ps.min():+.2f} to {delay_ps.max():+.2f}",
                f"{noise_db:.1f}",
            ]
        )
    columns = ("", "live", "dead", "noisy", "gain (dB)", "mean delay (ps)", "delay (ps)")
    print_table([*columns, "noise (dB)"], rows)
    parts = []
    for name, value in channels.target_position.items():
        what, unit = name.rsplit("_", 1)
        scale, shown = (1e3, "mm") if unit == "m" else (1.0, "deg")
        std = scale * channels.target_std[name]
        parts.append(f"{what} {scale * value:.3f} +- {std:.3f} {shown}")
    print_line(f"{channels.target}: {', '.join(parts)}")
    print_line(
        f"{output}: {channels.residual_db:.1f} dB of the echoes is left, "
        f"{channels.noise_residual_db:.1f} dB by noise"
    )
    if channels.residual_db > channels.noise_residual_db + UNEXPLAINED_DB:
        print_warning(
            f"{channels.residual_db - channels.noise_residual_db:.0f} dB more is left than noise "
            "would leave: other echoes, or a target that is not quite what it was said to be"
        )

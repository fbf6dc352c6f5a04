"""``clradar channels``: estimate gain and delay of every channel from a known target."""

from __future__ import annotations

from pathlib import Path

import clradar as cl
from clradar.cli.console import print_line, print_table, progress_bar
from clradar.cli.inputs import title_of
from clradar.cli.options.channels import EstimateOptions, TargetOptions
from clradar.cli.options.common import FORCE
from clradar.cli.options.groups import REQUIRED, argument, option, output_option
from clradar.cli.options.measured import FrameOptions
from clradar.cli.outputs import check_figure, check_outputs, provenance, save


def command(
    *,
    capture: Path = argument(
        "Of the target: native capture, recorded .npy frame, or radar folder.",
        REQUIRED,
        metavar="CAPTURE",
    ),
    target: TargetOptions,
    output: Path = output_option("Channels to write (HDF5).", REQUIRED),
    estimate: EstimateOptions,
    plot: Path | None = option(
        "Also draw gains, phases and delays: .png, .pdf or .svg.", names=("--plot", "--figure")
    ),
    frames: FrameOptions,
    force: bool = FORCE,
) -> None:
    """The target's position is refined, too. Which errors are observable:
    docs/channel-calibration.md. The mean of a recording's frames: `clradar clean --average`.
    """
    from calibration import estimate_channels
    from calibration.channels.figure import channels_figure
    from clradar.plot import save_figure

    known = target.read()
    check_figure(plot)
    check_outputs([output, plot], force=force, inputs=[capture])
    loaded, files = frames.open(capture)
    with progress_bar("fitting channels") as progress:
        channels = estimate_channels(loaded, known, progress=progress, **estimate.settings())
    origin = provenance("channels", files, target, estimate, frames)
    save(output, channels, origin, force=force)
    print_summary(output, channels)
    if plot is not None:
        save_figure(channels_figure(channels, title_of(capture, loaded.meta)), plot, force=force)
        print_line(f"{plot}: gains, phases and delays")


def print_summary(output: Path, channels: cl.ChannelCalibration) -> None:
    """Print gains and delays of both sides, the target's position, and the residual."""
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
        parts.append(f"{what} {scale * value:.3f} ± {std:.3f} {shown}")
    print_line(f"{channels.target}: {', '.join(parts)}")
    print_line(
        f"{output}: {channels.residual_db:.1f} dB of the echoes is left, "
        f"{channels.noise_residual_db:.1f} dB by noise"
    )

"""``clradar channels``: estimate gain and delay of every channel from a known target."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from clradar.cli import options as opt, parse
from clradar.cli.console import print_text, progress_bar
from clradar.cli.inputs import title_of
from clradar.cli.outputs import write


def command(
    *,
    capture: Path = opt.argument(
        "Of the target: native capture, recorded .npy frame, or radar folder.",
    ),
    target: opt.TargetOptions,
    output: Path = opt.output_option("Channels to write (HDF5)."),
    estimate: opt.EstimateOptions,
    plot: Path | None = opt.written(
        "Also draw gains, phases and delays: .png, .pdf or .svg.",
        "--plot",
        "--figure",
        check=parse.figure,
    ),
    frames: opt.FrameOptions,
) -> None:
    """The target's position is refined, too. Which errors are observable:
    docs/channel-calibration.md. The mean of a recording's frames: `clradar clean --average`.
    """
    from calibration import estimate_channels
    from calibration.channels.figure import channels_figure
    from measurement_io.record_facts import Description, facts_of

    known = target.read()
    loaded = opt.open_frame(capture, frames)
    with progress_bar("fitting channels") as progress:
        channels = estimate_channels(loaded, known, progress=progress, **estimate.settings())
    channels = write(output, channels)
    facts = facts_of(channels)
    first = [fact.name for fact in facts].index("dead Tx")  # what is before is of the capture, too
    print_text(str(Description(str(output), "channels", tuple(facts[first:-1]))))
    figure = partial(channels_figure, channels, title_of(capture, loaded.meta))
    write(plot, figure, "gains, phases and delays")

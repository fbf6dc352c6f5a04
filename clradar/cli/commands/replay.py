"""``clradar replay``: send a recording to ``clradar live``, at its own rate."""

from __future__ import annotations

from pathlib import Path

from clradar.cli.console import print_line
from clradar.cli.options.groups import REQUIRED, argument, option
from clradar.cli.options.recording import Variant


def command(
    path: Path = argument(REQUIRED, "Recording to send.", metavar="RECORDING"),
    *,
    to: str = option(REQUIRED, "Where `clradar live tcp:PORT` listens.", metavar="HOST:PORT"),
    rate_hz: float | None = option(
        None,
        "Frames per second; inf: as fast as they go. [default: by their time stamps, or 8]",
        metavar="HZ",
    ),
    repeat: int = option(1, "Send the recording so often.", metavar="N", min=1),
    variant: Variant = option("raw", "Variant of the frames."),
) -> None:
    """Frames that cannot be read are left out. docs/live.md has the form of the stream."""
    from clradar.live import replay
    from clradar.live.sources import parsed_address
    from clradar.measurement_io import open_recording

    host, port = parsed_address(to)
    recording = open_recording(path, variant=variant)
    replay(recording, host, port, rate_hz=rate_hz, repeats=repeat, say=print_line)

"""`clradar live`: frames are imaged as they come.

`wire` is the form of frames on a stream, `sources` bring frames into an `inbox`, which keeps the
newest alone, `loop` images and counts them, `screen` shows them in a terminal, `page` in the
browser; `replay` sends a recording. Data flows in that order.
"""

from clradar.live.loop import LiveImages, Shown, run
from clradar.live.replay import replay
from clradar.live.sources import Source, open_source

__all__ = ["LiveImages", "Shown", "Source", "open_source", "replay", "run"]


def __dir__() -> list[str]:
    return sorted(__all__)

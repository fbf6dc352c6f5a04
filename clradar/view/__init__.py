"""The live view in a browser: files in, pictures of them, wishes, and the page of viser.

`sources` opens paths, `pictures` and `channels` turn records into arrays to draw, `session` carries
out what is wished in the background, `front` and `panel` are the page. Data flows in that order.
"""

from clradar.view.server import serve

__all__ = ["serve"]


def __dir__() -> list[str]:
    return sorted(__all__)

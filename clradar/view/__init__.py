"""The live view in a browser: files in, pictures of them, wishes, and the page of viser.

`sources` opens paths, `beside` what is shown with them; `pictures`, `slices` and `channels` turn
records into drawings and points; `session` carries out a `wish` in the background, `scene`
and `panel` are the `page`. Data flows in that order.
"""

from clradar.view.server import serve

__all__ = ["serve"]


def __dir__() -> list[str]:
    return sorted(__all__)

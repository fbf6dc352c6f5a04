"""The view in a browser: frames in, pictures of them, wishes, and the page of viser.

`sources` reads frames, `beside` what is shown with them; `drawn` and `pictures` turn images into
points and pictures; `session` carries out a `wish` in the background, and `playing` follows frames
that come; `scene` and `panel` are the page, `server` and `gate` serve it. Data flows in that order.
"""

from clradar.view.server import show

__all__ = ["show"]


def __dir__() -> list[str]:
    return sorted(__all__)

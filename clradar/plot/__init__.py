"""Figures of images and comparisons, in the radar's view (x increases to the left), and captures.

Everything is built on `matplotlib.figure.Figure`: no pyplot, no open windows, no state between
calls.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

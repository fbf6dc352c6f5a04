"""Simulate, read, image and compare captures of near-field imaging radars."""

import sys
from importlib import import_module
from types import ModuleType

import lazy_loader

__version__ = "0.3.0"

# Names are imported on first use, so that commands and readers import what they need.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _Package(ModuleType):
    def __setattr__(self, name, value):
        # Python sets an imported module on its package. Functions of these names stay functions.
        names = ("backproject", "compare", "synthesize", "trace")
        if not (isinstance(value, ModuleType) and name in names):
            super().__setattr__(name, value)

    def __reduce__(self):
        return import_module, (self.__name__,)  # for functions that name it, on workers of Dask


sys.modules[__name__].__class__ = _Package

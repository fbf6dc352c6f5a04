"""Simulate, read, image and compare captures of near-field imaging radars."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

TYPE_CHECKING = False  # that of typing takes half the time until Ctrl-C is heard
if TYPE_CHECKING:
    from typing import Any

    from clradar.public_names import *  # noqa: F403

__version__ = "0.3.0"


def __getattr__(name: str) -> Any:
    # Everything is imported on first use, so that commands and readers import what they need.
    if name == "arrays":
        return import_module("clradar.arrays")
    if name == "open_dataset":  # needs xarray, and imports this package
        return import_module("clradar.dataset").open_dataset
    if name != "__all__" and name.startswith("__"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    public = import_module("clradar.public_names")
    globals().update({n: getattr(public, n) for n in public.__all__})
    globals()["__all__"] = sorted([*public.__all__, "__version__", "open_dataset"])
    if name not in globals():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals()[name]


def __dir__() -> list[str]:
    return list(__getattr__("__all__"))


class _Package(ModuleType):
    def __setattr__(self, name: str, value: Any) -> None:
        # Python sets an imported module on its package. Functions of these names stay functions.
        names = ("backproject", "compare", "synthesize", "trace")
        if not (isinstance(value, ModuleType) and name in names):
            super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        return import_module, (self.__name__,)  # for functions that name it, on workers of Dask


sys.modules[__name__].__class__ = _Package

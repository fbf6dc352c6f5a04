"""A package under a second name: the same modules, never copies of them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any

from clradar.files.own_packages import require_own


def stand_for(name: str, package: str) -> None:
    """Make the module `name` one with our package, and all modules below it with the package's.

    Raises
    ------
    PackageError
        Python does not find our package by its name.
    """
    require_own(package)
    import_module(package)
    # What is loaded is known by both names at once. Importing a module sets it as an attribute of
    # its package, which would replace a function of the same name, such as `describe`.
    for loaded in list(sys.modules):
        if loaded == package or loaded.startswith(f"{package}."):
            sys.modules[name + loaded[len(package) :]] = sys.modules[loaded]
    sys.meta_path.insert(0, _SecondName(name, package))


class _SecondName(MetaPathFinder, Loader):
    """Finds modules below `name` as those of `package`, before others make copies of them."""

    def __init__(self, name: str, package: str) -> None:
        self._name, self._package = name, package

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(f"{self._name}."):
            return None
        found = find_spec(self._own(fullname))
        return None if found is None else ModuleSpec(fullname, self, origin=found.origin)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(self._own(spec.name))
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # It has run under its own name; importing it under this one has replaced its record.
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state

    def get_code(self, fullname: str) -> CodeType | None:
        """For ``python -m``."""
        found: Any = find_spec(self._own(fullname))
        code: CodeType | None = found.loader.get_code(found.name)
        return code

    def _own(self, fullname: str) -> str:
        return self._package + fullname[len(self._name) :]

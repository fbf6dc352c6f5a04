"""Every public function and class has a runnable example, which does what it shows."""

from __future__ import annotations

import doctest
import importlib
import inspect
from typing import Any

import pytest

from clradar.errors import ClradarError

PACKAGES = (
    "clradar",
    "clradar.arrays",
    "clradar.hand",
    "clradar.rigs",
    "clradar.dataset",
    "clradar.report",
    "clradar.opencl",
    "measurement_io",
    "calibration",
)
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def documented() -> dict[str, Any]:
    """Public functions and classes by the name that users import; each once."""
    found: dict[str, Any] = {}
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            item = getattr(module, name)
            error = inspect.isclass(item) and issubclass(item, ClradarError)  # docs/messages.md
            if not error and (inspect.isfunction(item) or inspect.isclass(item)):
                found.setdefault(
                    f"{item.__module__}.{item.__qualname__}", (f"{package}.{name}", item)
                )
    return dict(found.values())


DOCUMENTED = documented()


@pytest.mark.parametrize("name", DOCUMENTED)
def test_example(name: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    item = DOCUMENTED[name]
    finder = doctest.DocTestFinder(recurse=False)
    (test,) = finder.find(item, name, module=False, globs={})
    assert test.examples, f"{name} has no example in its docstring"
    output: list[str] = []
    doctest.DocTestRunner(optionflags=FLAGS).run(test, out=output.append)
    assert not output, "".join(output)

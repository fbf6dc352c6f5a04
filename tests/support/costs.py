"""What tests cost: processor seconds by file and by fixture, of all processes of a run.

A plugin: `pytest --costs FILE.json` writes them and prints the dearest; `.ci/run` does.
"""

import json
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

DEAREST = 20

_files: Counter[str] = Counter()
_fixtures: Counter[str] = Counter()


def _processor_s() -> float:
    """Of this process and of those that it has waited for."""
    return sum(os.times()[:4])


@contextmanager
def _counted(where: Counter[str], name: str) -> Iterator[None]:
    begin = _processor_s()
    try:
        yield
    finally:
        where[name] += _processor_s() - begin


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    with _counted(_files, item.location[0]):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any, request: pytest.FixtureRequest) -> Iterator[None]:
    """A fixture that needs another one counts without it: that was made before."""
    with _counted(_fixtures, f"{fixturedef.baseid}::{fixturedef.argname}"):
        return (yield)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):  # a process of pytest-xdist
        session.config.workeroutput["costs"] = [dict(_files), dict(_fixtures)]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    for total, own in zip((_files, _fixtures), node.workeroutput.get("costs", []), strict=False):
        total.update(own)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    path = config.getoption("--costs")
    if path is None or hasattr(config, "workeroutput"):
        return
    found = {
        name: {key: round(seconds, 2) for key, seconds in total.most_common()}
        for name, total in (("files", _files), ("fixtures", _fixtures))
    }
    whole_s = sum(_files.values())
    Path(path).write_text(json.dumps({"processor_s": round(whole_s, 2), **found}, indent=1))
    terminalreporter.section(f"{whole_s:.0f} s of processor time; the dearest, in {path} all")
    both = [*_files.items(), *((f"fixture {name}", s) for name, s in _fixtures.items())]
    for name, seconds in sorted(both, key=lambda one: -one[1])[:DEAREST]:
        terminalreporter.line(f"{seconds:8.1f} s  {name}")

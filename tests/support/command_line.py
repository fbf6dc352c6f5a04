"""Runs of the command line in the tests' own process."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

import pytest

from clradar.cli import main

EDGE_MM = "4"
DENSITY = "0.2"
GRID = ("--x-mm", "-60:60:6", "--y-mm", "-90:90:6", "--z-mm", "280:320:5")
"""21 x 31 x 9 voxels: no finer than the SSIM's window of 11 pixels needs."""

Run = Callable[..., "Outcome"]

Group = TypeVar("Group")


def group_of(group: type[Group], **given: Any) -> Group:
    """A group of options from what is typed, as a command gets it."""
    for one in fields(group):  # type: ignore[arg-type]
        if one.metadata["parse"] is not None and one.name in given:
            name = "--" + one.name.replace("_", "-")
            given[one.name] = one.metadata["parse"](name, given[one.name])
    return group(**given)


class Outcome:
    """Exit status and both streams of one command."""

    def __init__(self, status: int, out: str, err: str) -> None:
        self.status, self.out, self.err = status, out, err


def exit_status(*arguments: object) -> int:
    """What a command ends with; what it writes is left to `capsys`."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return int(ended.value.code or 0)


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit status and both streams of a command."""
    capsys.readouterr()
    status = exit_status(*arguments)
    return status, *capsys.readouterr()


def one_error_line(outcome: Outcome, *parts: str) -> None:
    assert outcome.status == 1, outcome.err
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("clradar: error: ")
    for part in parts:
        assert part in lines[0]

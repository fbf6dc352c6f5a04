"""Runs of the command line in the tests' own process."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar

import pytest

from clradar.cli import main

EDGE_MM = "4"
DENSITY = "0.2"
GRID = "--x-mm -60:60:6 --y-mm -90:90:6 --z-mm 280:320:5"
"""21 x 31 x 9 voxels: no finer than the SSIM's window of 11 pixels needs."""

Group = TypeVar("Group")


def group_of(group: type[Group], **given: Any) -> Group:
    """A group of options from what is typed, as a command gets it."""
    for one in fields(group):  # type: ignore[arg-type]
        if one.metadata["parse"] is not None and one.name in given:
            name = "--" + one.name.replace("_", "-")
            given[one.name] = one.metadata["parse"](name, given[one.name])
    return group(**given)


class Outcome(NamedTuple):
    """Exit status and both streams of one command."""

    status: int
    out: str
    err: str


def exit_status(*arguments: object) -> int:
    """What a command ends with; what it writes is left to `capsys`."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return int(ended.value.code or 0)


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> Outcome:
    """Exit status and both streams of a command."""
    capsys.readouterr()
    status = exit_status(*arguments)
    return Outcome(status, *capsys.readouterr())


@contextmanager
def worker_here() -> Iterator[str]:
    """The address of a Dask scheduler whose one worker is a thread of this process."""
    from distributed import LocalCluster

    with LocalCluster(
        processes=False, n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0",
        resources={"DEVICE": 1},
    ) as cluster:  # fmt: skip
        yield str(cluster.scheduler_address)


class Cli:
    """Commands, each given as one line of words."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def __call__(self, line: str) -> Outcome:
        return run(self.capsys, *line.split())

    def ok(self, line: str) -> Outcome:
        """What a command that succeeds prints."""
        outcome = self(line)
        assert outcome.status == 0, outcome.err
        return outcome

    def fails(self, line: str, *parts: str, status: int = 1) -> None:
        """The command ends with one line, which has these parts; wrong usage with status 2."""
        outcome = self(line)
        assert outcome.status == status, outcome.err
        (error,) = outcome.err.splitlines()
        assert error.startswith("clradar: error: "), error
        assert "unexpected" not in error
        assert all(part in error for part in parts), error

"""Mutated inputs for every reader; `make fuzz` tries 100 000 of each."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from clradar.errors import MeasurementError
from fuzz import harness
from fuzz.targets import TARGETS, Target

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or os.getenv("CLRADAR_READERS") == "spawn",
    reason="readers are watched as Linux alone can, and not where each file starts a process",
)


@pytest.mark.parametrize("name", TARGETS)
def test_short_run(name, tmp_path):
    target = TARGETS[name]
    outcome = harness.run(target, target.short_run, keep=tmp_path)
    assert not outcome.faults, str(outcome)
    assert outcome.results + outcome.errors == target.short_run
    # Mutants that are all refused at the first byte, or all accepted, try nothing.
    assert outcome.results > 0, str(outcome)
    assert outcome.errors > 0 or name == "calibration_json", str(outcome)
    made = [target.mutated(3, index) for index in range(10)]
    assert made == [target.mutated(3, index) for index in range(10)]
    assert len(set(made)) > 5


# ---- the harness itself: readers that misbehave, each in a way that it has to notice


class Numbered(Target):
    """A target whose input number `index` is that number, as text."""

    def mutated(self, seed, index):
        return b"%d" % index


def _raise(error):
    raise error


def _run_a_command(path):
    try:
        os.system("true")
    except Exception as error:
        raise MeasurementError(f"{path}: hidden") from error


def _hang(path):
    while True:
        pass


FAULTS: dict[str, Callable[[Path], object]] = {
    "raises KeyError": lambda path: _raise(KeyError("a key")),
    "says": lambda path: _raise(MeasurementError(f"{path}: one line\nand another")),
    "does not name the file": lambda path: _raise(MeasurementError("something is wrong")),
    "os.system": _run_a_command,
    "executes": lambda path: eval("1 + 1"),
    "for writing": lambda path: path.with_name("written").write_text("x"),
    "/etc/hostname": lambda path: Path("/etc/hostname").read_bytes(),
    "MB of memory": lambda path: np.ones(500_000_000, np.uint8),  # more than garbage that goes
    "of processor time": _hang,
}
"""What is said of a fault -> the reader that has it."""


def test_faults_of_readers_are_detected(tmp_path):
    """Every second input has the next of the faults; all others are read, each once."""

    def read(path):
        content = path.read_bytes()
        if content == b"seed":
            return content
        number, rest = divmod(int(content), 2)
        if rest:
            list(FAULTS.values())[number](path)
        raise MeasurementError(f"{path}: expected the seed, got something else")

    limits = {"processor_limit_s": 0.5, "resident_limit_bytes": 50_000_000}
    target = Numbered("input", lambda: [b"seed"], read, bytes, **limits)
    count = 2 * len(FAULTS) + 1
    outcome = harness.run(target, count, keep=tmp_path / "kept")
    assert [index for index, _, _ in outcome.faults] == list(range(1, count, 2)), str(outcome)
    for index, what, saved in outcome.faults:
        assert int(saved.read_bytes()) == index
        assert list(FAULTS)[index // 2] in what
        assert str(saved) in str(outcome)
    assert (outcome.results, outcome.errors) == (0, count - len(FAULTS))

"""Mutated inputs for every reader: some hundred with all the tests, 100 000 in `make fuzz`."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz import campaign
from fuzz.broken_readers import ENDLESS, FATAL, MILD
from fuzz.mutate_hdf5 import lookup3, with_right_checksums
from fuzz.targets import TARGETS

ROOT = Path(__file__).resolve().parents[2]
LONG_RUN = 100_000


@pytest.mark.parametrize("name", TARGETS)
def test_short_run(name, tmp_path):
    count = TARGETS[name].short_run
    outcome = campaign.run(name, count, keep=tmp_path)
    assert not outcome.faults, str(outcome)
    assert outcome.results + outcome.errors == count
    # Mutants that are all refused at the first byte, or all accepted, try nothing.
    assert outcome.results > 0, str(outcome)
    assert outcome.errors > 0 or name == "calibration_json", str(outcome)


@pytest.mark.slow
@pytest.mark.timeout(4 * 3600)
@pytest.mark.parametrize("name", TARGETS)
def test_long_run(name):
    keep = ROOT / "fuzz-faults"  # stays, to be looked at
    outcome = campaign.run(name, LONG_RUN, seed=1, keep=keep)
    assert not outcome.faults, str(outcome)
    assert outcome.results + outcome.errors == LONG_RUN


# ---- the harness itself


@pytest.mark.parametrize(
    ("name", "faults"), [("mild", MILD), ("fatal", FATAL), ("endless", ENDLESS)]
)
def test_faults_of_readers_are_detected(name, faults, tmp_path):
    count = 2 * len(faults) + 1
    outcome = campaign.run(f"fuzz.broken_readers:{name}", count, keep=tmp_path / "kept")
    assert len(outcome.faults) == len(faults), str(outcome)
    for fault in outcome.faults:
        number = int(fault.saved.read_bytes())
        assert number == fault.index
        assert list(faults)[number // 2] in fault.what
        assert str(fault.saved) in str(outcome)
    # All others were read, each once.
    assert (outcome.results, outcome.errors) == (0, count - len(faults))


@pytest.mark.parametrize("name", TARGETS)
def test_inputs_can_be_made_again(name):
    target = TARGETS[name]
    made = [target.mutated(3, index) for index in range(20)]
    assert made == [target.mutated(3, index) for index in range(20)]
    assert len(set(made)) > 10
    assert made != [target.mutated(4, index) for index in range(20)]


@pytest.mark.parametrize("name", ["native_capture", "native_volume"])
def test_checksums_of_hdf5(name):
    # Right ones stay, wrong ones become right: the hash is HDF5's.
    for content in TARGETS[name].seeds():
        assert with_right_checksums(content) == content
    content = TARGETS[name].seeds()[0]
    for place in (10, 40, content.index(b"OHDR") + 20):  # the superblock and the first header
        damaged = bytearray(content)
        damaged[place] ^= 1
        repaired = with_right_checksums(bytes(damaged))
        assert repaired != bytes(damaged)
        assert with_right_checksums(repaired) == repaired


def test_lookup3():
    # From the comments of the hash's source, lookup3.c.
    assert lookup3(b"") == 0xDEADBEEF
    assert lookup3(b"Four score and seven years ago") == 0x17770551

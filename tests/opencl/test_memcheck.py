"""Every kernel under the Oclgrind interpreter: bounds, data races, uninitialised reads.

Run with `make memcheck`, which installs Oclgrind in an environment of its own.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from clradar.opencl.sources import kernel_folder

pytestmark = pytest.mark.memcheck

ON_GPUS_ALONE = {"listed_probabilities", "count_probabilities"}
"""Kernels that only the one-lane form has."""

SCRIPT = Path(__file__).with_name("run_all_kernels.py")


def run_checked(tmp_path: Path, *arguments: str) -> tuple[str, str]:
    """Run the script under Oclgrind; return what it printed and what Oclgrind reported."""
    log = tmp_path / "oclgrind.log"
    environment = {
        **os.environ,
        "PYTHONPATH": str(SCRIPT.parents[2] / "benchmarks"),
        "CLRADAR_DEVICE": "oclgrind",
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_UNINITIALIZED": "1",
        "OCLGRIND_LOG": str(log),
        # With threads the check of uninitialised reads crashes or reports at random.
        "OCLGRIND_NUM_THREADS": "1",
        "PYOPENCL_NO_CACHE": "1",
    }
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, log.read_text() if log.exists() else ""


@pytest.mark.parametrize("width", [1, 8])
def test_no_report_from_any_kernel(tmp_path, width):
    printed, report = run_checked(tmp_path, str(width))
    assert report == ""
    defined = set()
    for file in kernel_folder().glob("*.cl"):
        defined |= set(re.findall(r"__kernel\s+void\s+(\w+)", file.read_text()))
    assert defined
    assert set(printed.split()) == (defined if width == 1 else defined - ON_GPUS_ALONE)


@pytest.mark.parametrize(
    ("fault", "word"),
    [("out-of-bounds", "Invalid write"), ("race", "race"), ("uninitialised", "uninitialized")],
)
def test_the_checker_reports_a_known_fault(tmp_path, fault, word):
    _, report = run_checked(tmp_path, "--faulty", fault)
    assert word.lower() in report.lower()

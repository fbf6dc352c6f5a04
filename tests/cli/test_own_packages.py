"""A lab's own files that have the names of our packages, and ``python -m clradar``."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from nightly import nightly

import clradar

ROOT = Path(clradar.__file__).resolve().parents[1]
CORRECT = ("clean", "none.h5", "--channels", "none.h5", "-o", "x.h5")
"""A command that imports both packages before it reads a file."""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A folder whose files have the names of ours, and must not run."""
    for name in ("calibration.py", "measurement_io.py", "kernels/__init__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("raise SystemExit('the file of the lab ran')\n")
    return tmp_path


def output_of(lab: Path, *arguments: str, path: str = str(ROOT)) -> tuple[int, str]:
    """Exit status and stderr of a run of Python in the folder."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=lab, env=os.environ | {"PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stderr


@pytest.mark.parametrize("module", ["clradar", *nightly(["clradar.cli"])])
def test_a_command_runs_beside_files_of_the_names_of_ours(lab: Path, module: str) -> None:
    status, err = output_of(lab, "-m", module, *CORRECT)
    assert (status, len(err.splitlines())) == (1, 1), err
    assert err.startswith("clradar: error: none.h5: no such file")


def test_the_file_that_hides_a_package_is_named(lab: Path) -> None:
    # The folder of a script is first on Python's path.
    (lab / "script.py").write_text("from clradar.cli import main; main(['devices'])")
    status, err = output_of(lab, "script.py")
    assert (status, len(err.splitlines())) == (1, 1), err
    assert err.startswith(f"clradar: error: {lab / 'calibration.py'}: hides ")
    assert "rename it" in err
    _, err = output_of(lab, "-c", "import clradar; clradar.open_dataset")
    assert f"clradar.errors.PackageError: {lab / 'measurement_io.py'}: hides " in err


def test_the_command_of_a_checkout_that_is_not_installed() -> None:
    # `python -m` finds clradar in the current folder only; that folder has to stay on the path.
    status, err = output_of(ROOT, "-m", "clradar", "inspect", "none.h5", path="")
    assert (status, err.split(": ")[2]) == (1, "none.h5")

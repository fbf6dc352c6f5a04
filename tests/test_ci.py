"""What `.ci/run` says at its end: a skipped test must not pass unseen."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / ".ci" / "run"
TOOLS = ("bash", "dirname", "mktemp", "rm", "tee", "grep", "id", "cat")
SKIPS = (
    "SKIPPED [14] tests/report/test_report_browser.py:19: no Chromium here",
    "SKIPPED [1] tests/files/confined/test_outside.py:322: this version survives it",
)

pytestmark = pytest.mark.skipif(not SCRIPT.exists(), reason="no checkout: .ci/run is not here")


def lines_of(tmp_path: Path, said: tuple[str, ...], status: int = 0) -> tuple[int, list[str]]:
    """Exit status and lines of the script on a machine without a browser, where `make test` says
    this and ends so."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in TOOLS:
        found = shutil.which(name)
        assert found is not None
        (programs / name).symlink_to(found)
    (tmp_path / "said").write_text("".join(f"{line}\n" for line in said))
    make = programs / "make"
    make.write_text(
        f'#!{shutil.which("bash")}\n[[ " $* " = *" test "* ]] || exit 0\n'
        f"cat {tmp_path}/said\nexit {status}\n"
    )
    make.chmod(0o755)
    done = subprocess.run(
        [str(SCRIPT)], env={**os.environ, "PATH": str(programs)}, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout.splitlines()


def test_skipped_tests_are_the_last_that_is_said(tmp_path):
    status, lines = lines_of(tmp_path, (*SKIPS, "3861 passed, 15 skipped"))
    assert status == 0
    at = lines.index("Passed, but NOT TRIED on this machine:")
    assert lines[at + 1 : -1] == list(SKIPS)
    assert "chromium" in lines[-1]


def test_a_failure_stays_one(tmp_path):
    status, lines = lines_of(tmp_path, ("1 failed",), 2)
    assert (status, lines[-1]) == (2, "1 failed")

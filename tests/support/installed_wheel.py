"""The wheel of this checkout, in an environment of its own."""

from __future__ import annotations

import os
import site
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def built_wheel(folder: Path) -> Path:
    """Build the wheel into a folder. Needs no package index: hatchling is installed for tests."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("clradar-*.whl")
    return wheel


class Environment:
    """A virtual environment with the wheel, and with what this Python has for its dependencies."""

    def __init__(self, folder: Path, wheel: Path) -> None:
        venv.create(folder, with_pip=False)
        scripts = folder / ("Scripts" if os.name == "nt" else "bin")
        self.python = scripts / Path(sys.executable).name
        self.packages = Path(self.run("import sysconfig; print(sysconfig.get_path('purelib'))"))
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(self.packages)
        # A line of a .pth file is a folder alone: the checkout that is installed there stays out.
        others = "\n".join(site.getsitepackages())
        (self.packages / "dependencies.pth").write_text(f"{others}\n", encoding="utf-8")

    def run(self, code: str, *arguments: str, cwd: Path | None = None) -> str:
        """What a program prints, its errors included, whatever its exit status."""
        variables = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        done = subprocess.run(
            [self.python, "-c", code, *arguments],
            cwd=cwd if cwd is not None else self.python.parent,
            env=variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        return done.stdout.strip()

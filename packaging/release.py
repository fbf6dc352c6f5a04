"""``make release``: build wheel and sdist, check them, and try each in a fresh environment.

Nothing is uploaded. The files are in dist/; the last lines say what is to be done before an upload.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import venv
from datetime import date
from pathlib import Path

from release_notes import Stated

ROOT = Path(__file__).resolve().parents[1]
TRIAL = Path(__file__).with_name("trial.py")


class Environment:
    """A virtual environment with nothing of ours but what is installed into it."""

    def __init__(self, folder: Path, *packages: str | Path) -> None:
        venv.create(folder, with_pip=True)
        self.scripts = folder / ("Scripts" if os.name == "nt" else "bin")
        self.run("python", "-m", "pip", "install", "--quiet", *packages)

    def run(self, program: str, *arguments: str | Path, cwd: Path | None = None) -> str:
        """What a program of the environment prints; a failure ends the release."""
        command = [str(self.scripts / program), *map(str, arguments)]
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
        done = subprocess.run(
            command, cwd=cwd or self.scripts, env=kept, stdout=subprocess.PIPE, text=True
        )
        if done.returncode != 0:
            print(done.stdout)
            raise SystemExit(f"release: '{' '.join(command)}' ended with {done.returncode}")
        return done.stdout


def built(work: Path, dist: Path) -> list[Path]:
    """Build sdist, and from it the wheel, into an empty folder; check what an index would see."""
    tools = Environment(work / "tools", "build", "twine")
    dist.mkdir(exist_ok=True)
    for old in dist.iterdir():
        old.unlink()
    tools.run("python", "-m", "build", "--outdir", dist, ROOT)
    files = sorted(dist.iterdir())
    print(tools.run("python", "-m", "twine", "check", "--strict", *files), end="")
    return files


def tried(work: Path, file: Path, version: str) -> None:
    """Install a file in an environment of its own; run the demo and the trial far from here."""
    folder = work / ("wheel" if file.suffix == ".whl" else "sdist")
    environment = Environment(folder, file)
    empty = folder / "empty"
    empty.mkdir()
    said = environment.run("clradar", "--version", cwd=empty).strip()
    if said != f"clradar {version}":
        raise SystemExit(f"release: {file.name}: expected clradar {version}, got '{said}'")
    environment.run("clradar", "demo", "-o", "demo", cwd=empty)
    print(f"{file.name}: {environment.run('python', '-I', TRIAL, ROOT, cwd=empty).strip()}")


def main() -> None:
    stated = Stated.read(ROOT)
    if wrong := stated.contradictions():
        raise SystemExit("\n".join(f"release: {line}" for line in wrong))
    with tempfile.TemporaryDirectory(prefix="clradar-release-") as name:
        files = built(Path(name), ROOT / "dist")
        if len(files) != 2:
            raise SystemExit(f"release: expected wheel and sdist, got {[f.name for f in files]}")
        for file in files:
            tried(Path(name), file, stated.versions["clradar/__init__.py"])
    for file in files:
        print(f"dist/{file.name}: SHA-256 {hashlib.sha256(file.read_bytes()).hexdigest()}")
    missing = stated.before_upload(date.today())
    print("NOT READY FOR AN UPLOAD:" if missing else "Ready for an upload, which is yours to do.")
    for line in missing:
        print(f"- {line}")


if __name__ == "__main__":
    sys.exit(main())

"""Commands in surroundings of other people: languages, names of folders, pipes, two at once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from nightly import nightly
from systems import posix_only

from measurement_io import open_volume

NAME = "Häñde und 手"
"""Blanks, umlauts, and what no code page of Europe has."""

ASCII = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}

CHAIN = """
import sys
from clradar.cli import main
for command in sys.argv[1:]:
    try:
        main(command.split(chr(10)))
    except SystemExit as end:
        print("ended: ", end.code or 0, ";", sep="", file=sys.stderr)
"""
"""A process that runs several commands."""


def started(folder: Path, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "clradar", *arguments],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def ended(process: subprocess.Popen[bytes]) -> tuple[int, bytes, bytes]:
    out, err = process.communicate()
    return process.returncode, out, err


@pytest.mark.parametrize("language", ["C", *nightly(["utf-8"])])
def test_blanks_and_umlauts_in_every_path(made: Path, tmp_path: Path, language: str) -> None:
    """A chain through all kinds of files, its folder and their names included."""
    environment = ASCII if language == "C" else {"PYTHONUTF8": "1"}
    folder = tmp_path / NAME
    folder.mkdir()
    for name in ("hand.ply", "sim.h5"):
        shutil.copy(made / name, folder / f"{NAME} {name}")
    shutil.copytree(made / "recording", folder / f"{NAME} recording")
    hand, sim = f"{NAME} hand.ply", f"{NAME} sim.h5"
    grid = ["--x-mm", "-60:60:6", "--y-mm", "-90:90:6", "--z-mm", "280:320:5"]
    chain: list[list[str]] = [
        ["simulate", hand, "-o", f"{NAME} 2.h5", "--samples-per-mm2", "0.05", "--band", "72:82:4"],
        ["image", sim, "-o", f"{NAME} volume.h5", *grid],
        ["convert", f"{NAME} recording", "-o", f"{NAME} frame.h5"],
        ["inspect", f"{NAME} recording"],
        ["export", f"{NAME} volume.h5", "-o", f"{NAME}.ply"],
        ["compare", f"{NAME} volume.h5", f"{NAME} volume.h5", "-o", f"{NAME}.png"],
        ["image", f"{NAME} missing.h5", "-o", "x.h5"],
    ]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", CHAIN, *map("\n".join, chain)],
        cwd=folder, env={**os.environ, **environment}, capture_output=True,
    )  # fmt: skip
    assert b"Traceback" not in done.stderr
    *passed, (err, status) = [said.split(b"ended: ") for said in done.stderr.split(b";\n")[:-1]]
    assert [status for _, status in passed] == [b"0"] * (len(chain) - 1), done.stderr
    for command in chain[:-1]:
        if "-o" in command:
            assert (folder / command[command.index("-o") + 1]).exists()
    assert status == b"1"
    assert err.count(b"\n") == 1
    assert (b"H\\udcc3\\udca4" if language == "C" else "Hä".encode()) in err


@posix_only
@pytest.mark.parametrize("command", ["materials", *nightly(["inspect recording --json"])])
def test_a_pipe_that_ends_is_no_error(made: Path, command: str) -> None:
    """As of `| head -1`: the reader is gone before the first line is written."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "clradar", *command.split()],
        cwd=made, stdout=writer, stderr=subprocess.PIPE, check=False,
    )  # fmt: skip
    os.close(writer)
    assert done.stderr == b""
    assert done.returncode != 0


IMAGE = ["image", "sim.h5", "--x-mm", "-60:60:6", "--y-mm", "-90:90:6", "--z-mm", "280:320:5"]
HAND = ["hand", "F", "--edge-mm", "4"]


@pytest.mark.parametrize(
    ("command", "force"),
    [(HAND, True), (IMAGE, False), *nightly([(HAND, False), (IMAGE, True)])],
)
def test_two_at_once_into_one_file(
    made: Path, tmp_path: Path, command: list[str], force: bool
) -> None:
    """One whole file; without --force one of both says that it exists already."""
    name = "out.ply" if command[0] == "hand" else "out.h5"
    arguments = [*command, "-o", str(tmp_path / name), *(["--force"] if force else [])]
    both = [started(made, *arguments) for _ in range(2)]
    results: list[Any] = [ended(process) for process in both]
    statuses = sorted(status for status, _, _ in results)
    assert statuses == ([0, 0] if force else [0, 1]), results
    for status, _, err in results:
        if status:
            assert b"exists already" in err
    assert [path.name for path in tmp_path.iterdir()] == [name]
    if name.endswith(".h5"):
        assert np.abs(open_volume(tmp_path / name).data).max() > 0
    else:
        assert len(trimesh.load(tmp_path / name).faces) > 100

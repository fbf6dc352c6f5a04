"""Outputs: nothing is overwritten, and streams hold what belongs there."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from command_line import Run, one_error_line
from systems import posix_only

from clradar.cli import console, outputs
from clradar.errors import DeviceError, OutputError


@posix_only
def test_check_outputs_resolves_links(tmp_path: Path) -> None:
    (tmp_path / "in.h5").write_bytes(b"")
    (tmp_path / "link.h5").symlink_to(tmp_path / "in.h5")
    with pytest.raises(OutputError, match="also an input"):
        outputs.check_outputs([tmp_path / "link.h5"], force=True, inputs=[tmp_path / "in.h5"])
    with pytest.raises(OutputError, match="cannot be written"):
        outputs.check_outputs([tmp_path / ("x" * 5000)], force=False)
    outputs.check_outputs([None, tmp_path / "new.h5"], force=False)
    with pytest.raises(OutputError, match="named twice"):
        outputs.check_outputs([tmp_path / "new.h5", tmp_path / "NEW.h5"], force=False)
    if not (tmp_path / "IN.h5").exists():  # where case counts
        outputs.check_outputs([tmp_path / "IN.h5"], force=False, inputs=[tmp_path / "in.h5"])


def test_a_table_in_a_pipe_is_not_cut(capsys: pytest.CaptureFixture[str]) -> None:
    long = "a [bold]name[/bold] " + 60 * "with words "
    console.print_table(("one", "two"), [(long, "1"), ("line\nbreak", "2")], right=("two",))
    lines = capsys.readouterr().out.splitlines()
    assert long.strip() in lines[2]
    assert "line break" in lines[3]


def test_error_lines_are_printable(capsys: pytest.CaptureFixture[str]) -> None:
    console.print_error("a\n\tb \x1b[31m \udcff")
    assert capsys.readouterr().err == "clradar: error: a b \\x1b[31m \\udcff\n"


def test_devices_marks_the_one_that_is_used(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = run("devices")
    assert outcome.status == 0
    (marked,) = [line for line in outcome.out.splitlines() if line.startswith("*")]
    assert "Portable Computing Language" in marked
    for column in ("selector", "name", "platform", "kind", "memory", "units", "works"):
        assert column in outcome.out
    monkeypatch.setenv("CLRADAR_DEVICE", "abacus")
    outcome = run("devices")
    one_error_line(outcome, "CLRADAR_DEVICE", "abacus")
    assert "Portable Computing Language" in outcome.out


def test_devices_without_opencl(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> None:
        raise DeviceError("no OpenCL platform was found")

    monkeypatch.setattr("clradar.opencl.device.list_devices", none)
    one_error_line(run("devices"), "no OpenCL platform")


@posix_only
@pytest.mark.parametrize(
    "command",
    ["convert sim.h5 -o {}/x.h5", "convert sim.h5 --to maroon -o {}/30",
     "image volume.h5 --png {}/x.png"],
)  # fmt: skip
def test_a_full_disk_is_one_error_line_and_leaves_nothing(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """A limit of the files' size, which a process meets as it does a full disk."""
    import resource  # which Windows has not
    import signal

    monkeypatch.chdir(made)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        outcome = run(*command.format(tmp_path).split())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    one_error_line(outcome, "cannot be written: File too large")
    assert list(tmp_path.iterdir()) == []


def test_names_that_are_no_text(run: Run, made: Path, tmp_path: Path) -> None:
    name = tmp_path / os.fsdecode(b"n\xff\xfe.h5")
    name.write_bytes((made / "volume.h5").read_bytes())
    outcome = run("compare", name, name, "--json", tmp_path / "x.json")
    assert outcome.status == 0, outcome.err
    assert json.loads((tmp_path / "x.json").read_text("utf-8"))["measured"] == str(name)


@pytest.mark.parametrize("command", ["inspect", "clean --average -o x.h5"])
def test_names_that_are_too_long(run: Run, command: str) -> None:
    first, *options = command.split()
    outcome = run(first, "n" * 300, *options)
    assert outcome.status == 1
    assert outcome.err.count("\n") == 1
    assert outcome.err.endswith("File name too long\n")
    assert "unexpected" not in outcome.err

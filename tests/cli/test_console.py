"""What a command takes and shows, what it keeps from being overwritten, and ``clradar devices``."""

import io
import json
import os
import sys
from pathlib import Path

import pytest
from layout_files import random_capture
from rig_files import RigMaker
from systems import posix_only

from clradar.cli import console
from clradar.cli.groups import call
from clradar.compare.metrics import METRIC_TABLE
from clradar.errors import DeviceError, MeshError
from clradar.model.progress import part_of, say_stage
from measurement_io import save_recording


def test_what_belongs_to_a_file_is_an_input_with_it(tmp_path):
    radar = save_recording(tmp_path / "plate", [random_capture()])
    hand = RigMaker().save(tmp_path / "hand.gltf", "file")
    frame = radar / "calibrated_data" / "000000.npy"
    for path, more in ((hand, hand.with_suffix(".bin")), (frame, radar / "antennas.toml")):
        assert call.files_of([path, more, tmp_path]) == [path, more]
    hand.write_text('{"uri":"hand.bin","uri": "x/../hand.bin"}')
    assert call.files_of([hand]) == [hand, hand.with_suffix(".bin")]
    hand.write_text('{"uri": "\\q.bin"}')
    with pytest.raises(MeshError, match=r"hand\.gltf: expected a glTF 2\.0 file, got"):
        call.files_of([hand])


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_progress_bar_says_what_is_done_now(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with console.bar("fitting") as progress:
        say_stage(progress, "[A], 1 of 24")
        part = part_of(progress, 0.0, 0.5)
        assert part is not None
        part(1, 2)
    assert "fitting: [A], 1 of 24" in terminal.getvalue()
    assert "25%" in terminal.getvalue()
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with console.bar("fitting") as progress:
        assert progress is None
    say_stage(progress, "simulating")


METRICS = [metric.name for metric in METRIC_TABLE]
VALUES = ["0.942", "0.919", "-101.25", "0.75", "11.77", "12.68", "13.36"]
TABLES = {
    "metrics": (["simulated", *METRICS], ["sim.h5", *VALUES], METRICS),
    "text": (
        ["axes", "phase", "frequencies", "x", "sharpness (dB)", "brightest at x, y, z (mm)", ""],
        ["[tx, rx]", "exp(-j)", "descending", "mirrored", "-12.3", "-100, -20, 300", "best"],
        ["sharpness (dB)", "brightest at x, y, z (mm)"],
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_fits_a_terminal(name, capsys):
    heads, row, right = TABLES[name]
    console.table(heads, [row], right=right)
    *lines, rule, cells = capsys.readouterr().out.splitlines()
    assert max(map(len, [*lines, rule, cells])) <= 80
    assert cells.split() == " ".join(row).split()
    assert sorted(" ".join(lines).split()) == sorted(" ".join(heads).split())
    assert set(rule) == {"-", " "}


def test_a_table_in_a_pipe_is_not_cut(capsys):
    long = "a [bold]name[/bold] " + 60 * "with words "
    console.table(("one", "two"), [(long, "1"), ("line\nbreak", "2")], right=("two",))
    lines = capsys.readouterr().out.splitlines()
    assert long.strip() in lines[2]
    assert "line break" in lines[3]


def test_error_lines_are_printable(capsys):
    console.error("a\n\tb \x1b[31m \udcff")
    assert capsys.readouterr().err == "clradar: error: a b \\x1b[31m \\udcff\n"


@posix_only
@pytest.mark.parametrize(
    "line",
    [
        "convert sim.h5 -o new/x.h5",
        "convert sim.h5 --to maroon -o new/30",
        "image volume.h5 --png new/x.png",
    ],
)
def test_a_full_disk_is_one_error_line_and_leaves_nothing(cli, place, line):
    """A limit of the files' size, which a process meets as it does a full disk."""
    import resource  # which Windows has not
    import signal

    Path("new").mkdir()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        cli.fails(line, "cannot be written: File too large")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert list(Path("new").iterdir()) == []


def test_names_that_are_no_text_or_too_long(cli, made):
    name = os.fsdecode(b"n\xff\xfe.h5")
    Path(name).write_bytes((made / "volume.h5").read_bytes())
    cli.ok(f"compare {name} {name} --json x.json")
    assert json.loads(Path("x.json").read_text("utf-8"))["measured"] == name
    cli.fails(f"inspect {'n' * 300}", "File name too long")
    cli.fails(f"clean {'n' * 300} --average -o x.h5", "File name too long")


def test_devices_marks_the_one_that_is_used(cli, monkeypatch):
    printed = cli.ok("devices").out
    (marked,) = [line for line in printed.splitlines() if line.startswith("*")]
    assert "Portable Computing Language" in marked
    for column in ("selector", "name", "platform", "kind", "memory", "units", "works"):
        assert column in printed
    monkeypatch.setenv("CLRADAR_DEVICE", "abacus")
    cli.fails("devices", "CLRADAR_DEVICE", "abacus")
    assert "Portable Computing Language" in cli("devices").out

    def none() -> None:
        raise DeviceError("no OpenCL platform was found")

    monkeypatch.setattr("clradar.cli.commands.lists.list_devices", none)
    cli.fails("devices", "no OpenCL platform")

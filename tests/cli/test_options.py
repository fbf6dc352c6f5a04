"""Groups of options: the command line they make, and the records that a command receives."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import pytest
import typer
from layout_files import random_capture
from rig_files import RigMaker
from typer.testing import CliRunner

from clradar.cli.call import Call, call, plain
from clradar.cli.groups import REQUIRED, argument, expanded, given, option, wrong_usage
from clradar.cli.options import DEVICE
from clradar.errors import MeshError
from measurement_io import save_recording


def between(name: str, text: str) -> tuple[int, ...]:
    if ":" not in text:
        raise wrong_usage(name, f"expected FIRST:LAST, got '{text}'")
    return tuple(map(int, text.split(":")))


@dataclass(frozen=True, kw_only=True)
class Base:
    window: Literal["rect", "hann"] = option("Weights.", "rect")


@dataclass(frozen=True, kw_only=True)
class Group(Base):
    source: Path = argument("What is read.", REQUIRED, metavar="SOURCE")
    edge_mm: float | None = option("Length of an edge.")
    size: tuple[float, float] | None = option("Width and height.")
    parts: list[str] | None = option("Parts.", None, "-p", "--part")
    span: tuple[int, ...] | None = option("From and to.", parse=between)
    left: bool = option("A left hand.", False, needs="--edge-mm")
    right: bool = option("A right hand.", False, without="--left -p")
    other: bool = option("Of another command.", False, needs="--nowhere")
    angle_deg: float | None = option("Of hann.", needs="--window=hann", due="--window=hann")


def outcome_of(line: str) -> tuple[int, str, list[object]]:
    """Exit status, output, and what a command received: record, count, device, its call, given."""
    received: list[object] = []

    def command(
        *, group: Group, count: int = option("How many.", REQUIRED), device: str | None = DEVICE
    ) -> None:
        received.extend([group, count, device, replace(call), given(group)])

    app = typer.Typer(rich_markup_mode=None)
    # The hints of a nested function name classes of this module.
    app.command()(expanded(command))
    result = CliRunner().invoke(app, line.split())
    return result.exit_code, result.output, received


def test_a_command_receives_records_and_single_options():
    line = "a.h5 --edge-mm 2 --window hann -p palm --part thumb --angle-deg 9 --left --count 7"
    status, output, received = outcome_of(f"{line} --device pocl --size 3 4 --span 1:3")
    assert status == 0, output
    values = {"edge_mm": 2.0, "window": "hann", "parts": ["palm", "thumb"], "angle_deg": 9.0}
    values["left"] = True
    group = Group(source=Path("a.h5"), size=(3.0, 4.0), span=(1, 3), **values)
    assert received[:3] == [group, 7, "pocl"]
    # What JSON reads back equal: all options of the command that results depend on.
    rest = {"source": "a.h5", "size": [3.0, 4.0], "span": [1, 3], "count": 7}
    kept = {**values, **rest, "right": False, "other": False}
    during = received[3]
    assert plain(during.options) == kept
    assert plain(during.options, paths=False) == {**kept, "source": None}
    assert during.inputs == {"SOURCE": [Path("a.h5")]}
    assert call == Call()  # the next one begins with none of it


def test_defaults_and_what_was_given():
    *_, (*_, typed) = outcome_of("a.h5 --count 7 --window rect")
    assert typed == {"--window": "rect", "SOURCE": Path("a.h5")}
    status, output, (group, _, device, *_) = outcome_of("a.h5 --count 7")
    assert status == 0, output
    assert (group, device) == (Group(source=Path("a.h5")), None)
    assert given(group) == {"SOURCE": Path("a.h5")}
    assert list(given(Group(source=Path("a"), edge_mm=0.0))) == ["SOURCE", "--edge-mm"]
    assert outcome_of("a.h5 --count 7 --other")[0] == 0
    status, _, received = outcome_of("a.h5 --count 7 --window taylor --left --right")
    assert (status, received) == (2, [])


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

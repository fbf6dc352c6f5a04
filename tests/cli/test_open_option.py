"""``--open``: on every command that writes a picture or a page, after it is written."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from command_line import GRID, Run

import clradar
from clradar.cli import opening
from clradar.cli.launcher import COMMANDS, context_of, module_of

DRAWING = {"save_figure", "image_report", "html_report", "frames_report", "write_contact_sheet"}
"""Functions that write pictures and pages."""
FOLLOWED = ("clradar.cli", "clradar.dataset.engine")
"""Where a command's own code is."""
PACKAGE = Path(clradar.__file__).parents[1]


def drawn_by(module: str, seen: set[str]) -> set[str]:
    """The functions above that a module names, or one of a command's own that it imports."""
    file = PACKAGE.joinpath(*module.split(".")).with_suffix(".py")
    if module in seen or ".options" in module or not file.is_file():
        return set()
    seen.add(module)
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute):
            found |= {node.attr} & DRAWING
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith(FOLLOWED):
            for named in (node.module, *(f"{node.module}.{one.name}" for one in node.names)):
                found |= drawn_by(str(named), seen)
        elif isinstance(node, ast.ImportFrom):
            found |= {one.name for one in node.names} & DRAWING
    return found


def mentioned(name: str) -> bool:
    """Whether an option of a command says that it writes a picture or a page."""
    helps = [str(getattr(p, "help", "")) for p in context_of(name).command.params]
    return any(suffix in text for text in helps for suffix in (".png", ".svg", ".html"))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_that_draws_can_open(name: str) -> None:
    options = [option for p in context_of(name).command.params for option in p.opts]
    # A table of metrics comes from the module that draws comparisons.
    draws = bool(drawn_by(module_of(name), set())) or mentioned(name)
    assert ("--open" in options) == draws


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Files that were opened; each was there."""
    found: list[Path] = []

    def launch(path: Path) -> None:
        assert path.read_bytes()
        found.append(path)

    monkeypatch.setattr(opening, "_launch", launch)
    monkeypatch.setenv("DISPLAY", ":0")
    return found


@pytest.mark.parametrize(
    ("line", "written"),
    [
        ("image {}/volume.h5 --png a.png", "a.png"),
        ("image {}/volume.h5 --png a.png --report a.html", "a.html"),
        ("inspect {}/volume.h5 --png a.png", "a.png"),
        ("compare {}/volume.h5 {}/volume.h5 -o b.png", "b.png"),
        ("compare {}/volume.h5 {}/volume.h5 --report b.html --json b.json", "b.html"),
    ],
)
def test_what_was_written_is_opened(
    run: Run,
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    opened: list[Path],
    line: str,
    written: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = line.replace("{}", str(made)).split()
    outcome = run(*arguments, "--open")
    assert outcome.status == 0, outcome.err
    assert opened == [tmp_path / written]
    opening.open_written(False, tmp_path / written)
    assert len(opened) == 1


def test_nothing_to_open_is_wrong_usage(run: Run, made: Path, tmp_path: Path) -> None:
    outcome = run("image", made / "sim.h5", "-o", tmp_path / "x.h5", *GRID, "--open")
    assert outcome.status == 2
    assert "--png or --report" in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_a_command_that_cannot_open_says_where_the_file_is(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = tmp_path / "a.png"
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    outcome = run("image", made / "volume.h5", "--png", picture, "--open")
    assert outcome.status == 0
    assert outcome.out.splitlines()[-1] == f"{picture}: not opened, since there is no display here"
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("PATH", str(tmp_path))
    outcome = run("image", made / "volume.h5", "--png", picture, "--open", "--force")
    assert outcome.status == 0
    assert outcome.out.splitlines()[-1] == f"{picture}: not opened: No such file or directory"

"""The budget of lines that `make lint` holds."""

import shutil
import subprocess
from pathlib import Path

import pytest
from test_release import program

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="no git here")

size = program("packaging/size.py")

BUDGET = """
[tool.clradar.budget]
"a" = 10
"a/b a/c.py" = 3
"tests" = 5
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    files = {"a/x.py": 9, "a/b/y.cl": 2, "a/c.py": 1, "tests/z.py": 5, "a/notes.md": 99, "d.py": 99}
    for name, lines in {**files, ".venv/w.py": 99}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("#\n" * lines)
    (tmp_path / ".gitignore").write_text("/.venv/\n")
    (tmp_path / "pyproject.toml").write_text(BUDGET)
    return tmp_path


def test_a_file_counts_for_the_nearest_part(tree, capsys):
    assert size.lines_of(tree, ["a", "a/b a/c.py", "tests"]) == {
        "a": 9, "a/b a/c.py": 3, "tests": 5,
    }  # fmt: skip
    assert size.main(tree, ["--check"]) == 0
    assert capsys.readouterr().out == ""


def test_a_part_above_its_number_fails_and_is_named(tree, capsys):
    (tree / "a/b/new.py").write_text("#\n" * 300)
    assert size.main(tree, ["--check"]) == 1
    assert "a/b a/c.py by 300 lines" in capsys.readouterr().out.splitlines()[-1]


def test_numbers_go_down_only(tree):
    (tree / "a/c.py").unlink()
    (tree / "tests/z.py").write_text("#\n" * 9)
    size.main(tree, ["--lower"])
    assert size.budget_of(tree) == {"a": 9, "a/b a/c.py": 2, "tests": 5}

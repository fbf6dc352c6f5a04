"""No test is timed: a limit of time is for what hangs, and no machine under load reaches it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

LEAST_S = 1800.0
"""Six times the 300 s that a test of 8 s of processor time reached on two cores at load 11."""

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "tests").rglob("*.py"))
LIMITS = re.compile(r"timeout|limit_s|deadline|LIMIT_S|DEADLINE_S", re.IGNORECASE)


def limits_of(tree: ast.Module) -> list[tuple[str, float]]:
    """The numbers that limit the time of something: arguments, defaults, constants by name."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword):
            pairs = [(node.arg or "", node.value)]
        elif isinstance(node, ast.Assign):
            pairs = [(ast.unparse(target), node.value) for target in node.targets]
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            pairs = [(ast.unparse(node.target), node.value)]
        elif isinstance(node, ast.FunctionDef):
            names = node.args.posonlyargs + node.args.args
            given = zip(reversed(names), reversed(node.args.defaults), strict=False)
            pairs = [(argument.arg, value) for argument, value in given]
        else:
            continue
        found += [
            (name, float(value.value))
            for name, value in pairs
            if isinstance(value, ast.Constant) and isinstance(value.value, int | float)
            and LIMITS.search(name) and "CPU" not in name
        ]  # fmt: skip
    return found


def test_no_limit_is_reached_under_load() -> None:
    short = {
        (path.name, name, value)
        for path in FILES
        for name, value in limits_of(ast.parse(path.read_text(encoding="utf-8")))
        if value < LEAST_S
    }
    # Those of processor time, which the harness of the fuzzer has to enforce.
    assert short == {
        ("run.py", "LIMIT_S", 300.0),
        ("test_campaigns.py", "limit_s", 60.0),
        ("targets.py", "processor_limit_s", 10.0),
    }


def test_the_limit_of_every_test() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (limit,) = re.findall(r"^timeout = (\d+)$", text, re.MULTILINE)
    assert float(limit) >= LEAST_S
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    limits = [float(found) for found in re.findall(r"--timeout (\d+)", makefile)]
    assert limits
    assert min(limits) >= LEAST_S


def test_limits_are_found() -> None:
    source = "run(timeout=3)\nWAIT_LIMIT_S = 2.0\ndef f(a, limit_s=1.0): pass\nx(y=1)"
    found = sorted(limits_of(ast.parse(source)))
    assert found == [("WAIT_LIMIT_S", 2.0), ("limit_s", 1.0), ("timeout", 3.0)]

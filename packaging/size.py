"""Lines of code by part, beside the budget of `[tool.clradar.budget]` in pyproject.toml.

python packaging/size.py            the table
python packaging/size.py --check    status 1 if a part is above its number
python packaging/size.py --lower    write today's numbers where they are lower
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

KINDS = (".py", ".pyi", ".cl", ".h", ".js", ".css", ".html")
OUTSIDE = ("benchmarks", "examples", "tests")
"""What is no part of the product."""


def budget_of(root: Path) -> dict[str, int]:
    """Most lines of each part: folders and files, with blanks between them."""
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))
    return project["tool"]["clradar"]["budget"]


def files_of(root: Path) -> list[str]:
    """Code that git tracks, or would: files that it does not ignore."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    return [n for n in listed.splitlines() if n.endswith(KINDS) and (root / n).is_file()]


def lines_of(root: Path, parts: Sequence[str]) -> dict[str, int]:
    """Lines of each part; a file belongs to the longest path that leads to it."""
    owner = {path: part for part in parts for path in part.split()}
    lines = dict.fromkeys(parts, 0)
    for name in files_of(root):
        above = (name, *(str(parent) for parent in Path(name).parents))
        part = next((owner[path] for path in above if path in owner), None)
        if part is not None:
            lines[part] += (root / name).read_bytes().count(b"\n")
    return lines


def main(root: Path, arguments: Sequence[str]) -> int:
    """Print the table; the exit status."""
    budget = budget_of(root)
    lines = lines_of(root, list(budget))
    over = {part: n - budget[part] for part, n in lines.items() if n > budget[part]}
    product = [part for part in budget if part.split()[0] not in OUTSIDE]
    if "--check" not in arguments or over:
        print(f"{'part':52}{'lines':>8}{'at most':>9}")
        for part, n in lines.items():
            print(f"{part:52}{n:8}{budget[part]:9}" + (f"   +{over[part]}" if part in over else ""))
        print(
            f"{'product':52}{sum(lines[p] for p in product):8}{sum(budget[p] for p in product):9}"
        )
    if "--lower" in arguments:
        text = (root / "pyproject.toml").read_text("utf-8")
        for part, n in lines.items():
            text = re.sub(
                rf'^("{re.escape(part)}" = )(\d+)$',
                lambda found, n=n: f"{found[1]}{min(n, int(found[2]))}",
                text,
                flags=re.MULTILINE,
            )
        (root / "pyproject.toml").write_text(text, "utf-8")
    if "--check" in arguments and over:
        named = ", ".join(f"{part} by {n}" for part, n in over.items())
        print(
            f"Above the budget of pyproject.toml: {named} lines; CONTRIBUTING.md says what to do."
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parents[1], sys.argv[1:]))

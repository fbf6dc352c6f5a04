"""What the files of a checkout state about the release: version, date, address.

``python packaging/release_notes.py v1.2.3`` fails unless that may be uploaded today.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from datetime import date
from pathlib import Path

ISO_DATE = r"\d{4}-\d{2}-\d{2}"


@dataclass(frozen=True)
class Stated:
    """Version and date by file; a date is None in a file that states none."""

    versions: dict[str, str]
    dates: dict[str, str]
    unreleased: str
    """Entries of the change log that belong to no version."""
    repository: str
    repository_cited: str

    @classmethod
    def read(cls, root: Path) -> Stated:
        """Read the files below `root`; ValueError names the file that lacks a statement."""
        found = {}
        for name, path, pattern in (
            ("code", "clradar/__init__.py", r'^__version__ = "([^"]+)"$'),
            ("log", "CHANGELOG.md", rf"^## (\d[^ ]*) - {ISO_DATE}$"),
            ("logged", "CHANGELOG.md", rf"^## \d[^ ]* - ({ISO_DATE})$"),
            ("cited", "CITATION.cff", r"^version: (.+)$"),
            ("dated", "CITATION.cff", rf"^date-released: ({ISO_DATE})$"),
            ("conda", "packaging/conda/recipe.yaml", r'^  version: "([^"]+)"$'),
            ("address", "pyproject.toml", r'^repository = "([^"]*)"$'),
        ):
            match = re.search(pattern, (root / path).read_text("utf-8"), re.MULTILINE)
            if match is None:
                raise ValueError(f"{path}: expected a line like {pattern}, found none")
            found[name] = match[1]
        log = (root / "CHANGELOG.md").read_text("utf-8")
        pending = re.search(r"^## Unreleased\n(.*?)(?=^## )", log, re.MULTILINE | re.DOTALL)
        cited = re.search(
            r"^repository-code: *\"?([^\"\n]+)", (root / "CITATION.cff").read_text("utf-8"), re.M
        )
        return cls(
            versions={
                "clradar/__init__.py": found["code"],
                "CHANGELOG.md": found["log"],
                "CITATION.cff": found["cited"],
                "packaging/conda/recipe.yaml": found["conda"],
            },
            dates={"CHANGELOG.md": found["logged"], "CITATION.cff": found["dated"]},
            unreleased=pending[1].strip() if pending else "",
            repository=found["address"].rstrip("/"),
            repository_cited=cited[1].rstrip("/") if cited else "",
        )

    def contradictions(self) -> list[str]:
        """Statements that differ from each other: never right, released or not."""
        lines = []
        for what, stated in (("version", self.versions), ("date", self.dates)):
            if len(set(stated.values())) > 1:
                said = ", ".join(f"{file} {value}" for file, value in stated.items())
                lines.append(f"expected one {what}, found {said}")
        if self.repository != self.repository_cited:
            lines.append(
                f"expected one repository, found '{self.repository}' in pyproject.toml and "
                f"'{self.repository_cited}' in CITATION.cff (repository-code)"
            )
        return lines

    def before_upload(self, today: date) -> list[str]:
        """What has to be done before the files may be uploaded."""
        lines = []
        if self.unreleased:
            lines.append("CHANGELOG.md: entries under 'Unreleased' belong to a version")
        if (stated := self.dates["CHANGELOG.md"]) != today.isoformat():
            lines.append(f"CHANGELOG.md, CITATION.cff: dated {stated}, and today is {today}")
        if not self.repository:
            lines.append(
                "pyproject.toml: [tool.hatch.metadata.hooks.custom] has no repository, so the "
                "index would show no address, and README.md without its links and picture"
            )
        return lines

    def against_tag(self, tag: str, today: date) -> list[str]:
        """All that stands in the way of uploading the version with this tag."""
        version = self.versions["clradar/__init__.py"]
        other = [] if tag == f"v{version}" else [f"expected the tag v{version}, got '{tag}'"]
        return other + self.contradictions() + self.before_upload(today)


if __name__ == "__main__":
    root = Path(__file__).resolve().parents[1]
    sys.exit("\n".join(Stated.read(root).against_tag(sys.argv[1], date.today())) or None)

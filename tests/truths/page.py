"""One comparison, and the page docs/validation.md: numbers stand after each ``<!--mark-->``."""

import csv
import io
import re
from dataclasses import dataclass

MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class Row:
    """A number, what it should be, and the bound on their difference; with `at_most` on what was
    found by itself. `digits` are those after the point in tables."""

    case: str
    expected: float
    found: float
    bound: float
    unit: str = "dB"
    digits: int = 2
    at_most: bool = False

    @property
    def error(self) -> float:
        return self.found if self.at_most else abs(self.found - self.expected)

    @property
    def holds(self) -> bool:
        return self.error <= self.bound

    def cells(self) -> list[str]:
        """Cells of a table: case, truth, clradar, difference, bound, whether it holds."""

        def text(value: float) -> str:
            return f"{value:.{self.digits}f}".replace("-", MINUS)

        unit = f" {self.unit}" if self.unit else ""
        answer = "yes" if self.holds else "**no**"
        if self.at_most:
            return [self.case, "", text(self.found) + unit, "", "≤ " + text(self.bound), answer]
        return [
            self.case,
            text(self.expected) + unit,
            text(self.found) + unit,
            text(self.found - self.expected),
            "± " + text(self.bound),
            answer,
        ]


MARKED = re.compile(r"<!--([\w-]+)-->\n.*")
HEADER = ("comparison", "case", "truth", "clradar", "bound", "of", "unit", "holds")


def line(rows: list[Row]) -> str:
    """How many comparisons of a table hold, which do not, and which is the nearest to its bound."""
    failed = [row for row in rows if not row.holds]
    text = f"**{len(rows) - len(failed)} of {len(rows)}** hold"
    if failed:
        text += ", not: " + "; ".join(map(_text, failed))
    held = [row for row in rows if row.holds]
    return text + "; the nearest to its bound: " + _text(max(held, key=_share)) + "."


def _share(row: Row) -> float:
    return row.error / row.bound if row.bound > 0 else row.error - row.bound


def _text(row: Row) -> str:
    case, truth, found, _, bound, _ = row.cells()
    return f"{case}: {found}" + (f" for {truth}" if truth else "") + f" ({bound})"


def numbers(tables: dict[str, list[Row]]) -> str:
    """All comparisons as CSV."""
    lines = []
    for key, rows in tables.items():
        for row in rows:
            truth, found, bound = (
                f"{value:.{row.digits}f}" for value in (row.expected, row.found, row.bound)
            )
            bounded = ("", found, bound, "value") if row.at_most else (truth, found, bound, "error")
            lines.append((key, row.case, *bounded, row.unit, "yes" if row.holds else "no"))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([HEADER, *lines])
    return text.getvalue()


def summary(tables: dict[str, list[Row]]) -> str:
    """How many hold, and which do not."""
    rows = [row for part in tables.values() for row in part]
    failed = [f"{key}: {row.case}" for key, part in tables.items() for row in part if not row.holds]
    text = f"{len(rows) - len(failed)} of {len(rows)} comparisons hold."
    text += " These do not: " + "; ".join(failed) + "." if failed else ""
    return text + " [All numbers](validation.csv)."


def filled(page: str, tables: dict[str, list[Row]]) -> str:
    """The page with new numbers. Each table has a mark, and each mark a table."""
    lines = {"summary": summary(tables)} | {key: line(rows) for key, rows in tables.items()}
    assert set(MARKED.findall(page)) == set(lines)
    return MARKED.sub(lambda found: f"<!--{found[1]}-->\n{lines[found[1]]}", page)

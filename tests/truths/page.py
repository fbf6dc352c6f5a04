"""The page docs/validation.md: numbers stand in the line after each ``<!--mark-->``."""

import csv
import io
import re

from truths.record import Row

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

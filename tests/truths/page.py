"""The page docs/validation.md: the text of ``page.md`` with the measured numbers."""

import csv
import io
from pathlib import Path

from truths.record import Row

TEMPLATE = Path(__file__).with_name("page.md")
TABLE = "@table "
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
    return text if not failed else text + " These do not: " + "; ".join(failed) + "."


def filled(tables: dict[str, list[Row]]) -> str:
    """The page. Every table of the text has to be among `tables`, and the other way round."""
    out, used = [], set()
    for text in TEMPLATE.read_text(encoding="utf-8").splitlines():
        if text.startswith(TABLE):
            key = text[len(TABLE) :]
            used.add(key)
            text = line(tables[key])
        text = text.replace("@summary", summary(tables))
        out.append(text)
    assert used == set(tables), used ^ set(tables)
    return "\n".join(out) + "\n"


def prose() -> list[str]:
    """Lines of the text that the page has as they are."""
    lines = TEMPLATE.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("@")]

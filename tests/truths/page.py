"""The page docs/validation.md: the text of ``page.md`` with the measured numbers."""

from pathlib import Path

from truths.record import Row

TEMPLATE = Path(__file__).with_name("page.md")
TABLE = "@table "
HEADER = ("case", "truth", "clradar", "difference", "bound", "holds")


def table(rows: list[Row]) -> str:
    """Markdown; columns that are empty throughout are left out."""
    cells = [row.cells() for row in rows]
    kept = [i for i in range(len(HEADER)) if any(line[i] for line in cells)]
    lines = [[HEADER[i] for i in kept], ["---"] * len(kept)]
    lines += [[line[i] for i in kept] for line in cells]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def summary(tables: dict[str, list[Row]]) -> str:
    """How many hold, and which do not."""
    rows = [row for part in tables.values() for row in part]
    failed = [f"{key}: {row.case}" for key, part in tables.items() for row in part if not row.holds]
    text = f"{len(rows) - len(failed)} of {len(rows)} comparisons hold."
    return text if not failed else text + " These do not: " + "; ".join(failed) + "."


def filled(tables: dict[str, list[Row]]) -> str:
    """The page. Every table of the text has to be among `tables`, and the other way round."""
    out, used = [], set()
    for line in TEMPLATE.read_text(encoding="utf-8").splitlines():
        if line.startswith(TABLE):
            key = line[len(TABLE) :]
            used.add(key)
            line = table(tables[key])
        elif line == "@summary":
            line = summary(tables)
        out.append(line)
    assert used == set(tables), used ^ set(tables)
    return "\n".join(out) + "\n"


def prose() -> list[str]:
    """Lines of the text that the page has as they are."""
    lines = TEMPLATE.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("@")]

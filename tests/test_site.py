"""The documentation site: nothing is left out of it, and it asks for nothing from elsewhere."""

import ast
import re
import sys
from functools import cache
from pathlib import Path
from subprocess import run

import pytest
from test_doctests import PACKAGES
from test_imports import nodes

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TOCTREE = re.compile(r"```\{toctree\}\n(.*?)```", re.DOTALL)
ASSET = re.compile(
    r'<(?:script|link|img|iframe|source)\b[^>]*\b(?:src|href)="((?:https?:)?//[^"]+)'
)


def entries(page: Path) -> list[str]:
    """The pages in the toctrees of a page, relative to the folder of the documentation."""
    lines = [line for tree in TOCTREE.findall(page.read_text("utf-8")) for line in tree.split("\n")]
    names = (line.strip() for line in lines if line.strip() and not line.startswith(":"))
    return [str((page.parent / name).relative_to(DOCS)) for name in names]


def test_every_page_is_in_a_toctree_once():
    listed, waiting = ["index"], ["index"]
    while waiting:
        page = DOCS / f"{waiting.pop()}.md"
        found = entries(page) if page.exists() else []
        listed += found
        waiting += found
    pages = {
        str(path.relative_to(DOCS).with_suffix(""))
        for suffix in ("md", "rst")
        for path in DOCS.rglob(f"*.{suffix}")
        if path.relative_to(DOCS).parts[0] != "tutorials"
    }
    assert sorted(listed) == sorted({*pages, "tutorials/index"})


def test_every_public_name_has_a_page():
    """Of the packages whose examples are run, and of two that others' pages refer to."""
    packages = entries(DOCS / "api" / "index.md")
    assert {Path(p).name for p in packages} == {*PACKAGES, "clradar.plot", "clradar.model"}
    for package in packages:
        page = (DOCS / f"{package}.rst").read_text("utf-8")
        assert page.endswith(f"\n.. public-names:: {Path(package).name}\n")


def test_words_are_the_field_s_own():
    """Pages, and what the packages print, have none of the words that CONTRIBUTING.md lists."""
    rule = (ROOT / "CONTRIBUTING.md").read_text("utf-8").split("in messages and pages, too: not")[1]
    words = re.findall(r'"([a-z ]+)"', rule.split("\n")[0])
    assert len(words) > 3
    listed = re.compile(rf"\b({'|'.join(words)})\b", re.IGNORECASE)
    texts = [
        re.sub(r"```.*?```|`[^`]*`", "", page.read_text("utf-8"), flags=re.DOTALL)
        for page in (ROOT / "README.md", *DOCS.glob("*.md"), *ROOT.glob("examples/tutorials/*.py"))
    ]
    printed = [line for line in texts_of_code().split("\n") if " " in line]
    found = [match[0] for text in (*texts, *printed) for match in listed.finditer(text)]
    assert found == []


@cache
def texts_of_code() -> str:
    """Every string of the packages but docstrings, one a line, with … for what is filled in."""
    found = []
    for module in nodes().values():
        alone = {id(node.value) for node in module if isinstance(node, ast.Expr)}
        for node in module:
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                if id(node) not in alone:
                    found.append(node.value)
            elif isinstance(node, ast.JoinedStr):
                parts = (p.value if isinstance(p, ast.Constant) else "…" for p in node.values)
                found.append("".join(map(str, parts)))
    return "\n".join(" ".join(text.split()) for text in found)


def test_messages_are_those_of_the_code():
    """What the page quotes, but for values and the joints of what a message is made of."""
    page = (DOCS / "messages.md").read_text("utf-8")
    lists = page[page.index("## Install") : page.index("## Classes")]
    entries = re.findall(r"^- (.+?)(?=^- |^#|\Z)", lists, re.MULTILINE | re.DOTALL)
    quoted = [re.findall(r"`([^`]+ [^`]+)`", " ".join(entry.split())) for entry in entries]
    assert len(quoted) > 15
    assert all(quoted)
    known = texts_of_code()
    for message in (one for entry in quoted for one in entry if not one.startswith("clradar ")):
        for part in re.split(r"…|; |, then |expected |, got ", message):
            assert part.strip(" ,:()'") in known, f"{part!r} of {message!r}"


@pytest.mark.slow
def test_site_is_built_without_warnings_and_needs_no_network(tmp_path):
    """All but the tutorials, which `test_examples` runs; no sentence is taken for a type."""
    pytest.importorskip("sphinx", reason="needs pip install '.[docs]'")
    folders = ["-d", str(tmp_path / "doctrees"), str(DOCS), str(tmp_path / "site")]
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-Dplot_gallery=0", *folders]
    done = run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    texts = {str(p): p.read_text("utf-8") for p in (tmp_path / "site").rglob("*.html")}
    assert len(texts) > 50
    wrong = {p: ASSET.findall(t) + re.findall(">Type<", t) for p, t in texts.items()}
    assert not any(wrong.values()), wrong
    for sheet in (tmp_path / "site" / "_static").rglob("*.css"):
        assert not re.search(r"url\([\"']?(https?:)?//", sheet.read_text("utf-8")), sheet

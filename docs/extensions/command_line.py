"""The directive ``command-line``: every subcommand with its arguments and options, from typer."""

from __future__ import annotations

import inspect
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import typer
from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from clradar.cli.app import COMMANDS, PANELS, help_record, program

CODE = re.compile(r"`([^`]+)`|(?<![\w-])(--?[a-zA-Z][\w-]*|docs/[\w-]+\.md)")
PAGE = re.compile(r"docs/([\w-]+)\.md")

SHARED = 2
"""So many commands that have an option make it one that is described once."""

TITLE = "Options of several commands"

TASKS = (Path(__file__).parents[1] / "commands.md").read_text("utf-8").splitlines()
"""The page that has an example of every command."""

Record = tuple[str, str]


class CommandLine(SphinxDirective):
    """Documents the program and each of its subcommands in a section of its own."""

    has_content = False

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        root = context_of()
        contexts = {name: context_of(name) for name in COMMANDS}
        count = Counter(one for context in contexts.values() for one in records(context))
        shared = [one for one, n in count.items() if n >= SHARED and one[0].startswith("-")]
        common = nodes.section(ids=["clradar-common"], names=["common options"])
        common += nodes.title("", TITLE)
        common += definitions(shared)
        return [
            nodes.paragraph("", "", *words(help_of(root.command))),
            definitions(records(root)),
            *(
                group(title, {n: contexts[n] for n in panel}, shared)
                for title, panel in PANELS.items()
            ),
            common,
        ]


def context_of(name: str | None = None) -> Any:
    """The context of the program, or of a subcommand, without arguments."""
    root: Any = typer.main.get_command(program(name))
    context = root.make_context("clradar", [], resilient_parsing=True)
    if name is None:
        return context
    return root.commands[name].make_context(name, [], parent=context, resilient_parsing=True)


def group(title: str, contexts: dict[str, Any], shared: list[Record]) -> nodes.section:
    """The subcommands of a group."""
    made = nodes.section(ids=[f"group-{title.lower().replace(' ', '-')}"], names=[title])
    made += nodes.title("", title)
    made += [section(name, context, shared) for name, context in contexts.items()]
    return made


def example(name: str) -> str:
    """The first line of a subcommand on the page of tasks, without its comment."""
    calls = (line.split(" # ")[0].strip() for line in TASKS)
    return next(call for call in calls if call.split()[:2] == ["clradar", name])


def section(name: str, context: Any, shared: list[Record]) -> nodes.section:
    """A subcommand: what it does, how it is called, and what each option of its own means."""
    made = nodes.section(ids=[f"clradar-{name}"], names=[name])
    made += nodes.title("", name)
    for text in help_of(context.command).split("\n\n"):
        made += nodes.paragraph("", "", *words(text))
    pieces = " ".join(context.command.collect_usage_pieces(context))
    usage = f"clradar {name} {pieces}\n{example(name)}"
    made += nodes.literal_block(usage, usage, language="text")
    rows = records(context)
    made += definitions(one for one in rows if one not in shared)
    also = [names.split(", ")[-1].split(" ")[0] for names, text in rows if (names, text) in shared]
    link = nodes.reference("", TITLE, refid="clradar-common")
    made += nodes.paragraph("", "", link, *words(f": {', '.join(also)}."))
    return made


def records(context: Any) -> list[Record]:
    """Names and help of arguments and options."""
    found = (help_record(p, context) for p in context.command.get_params(context))
    return [one for one in found if one is not None]


def definitions(rows: Iterable[Record]) -> nodes.definition_list:
    """A definition list of arguments and options, as in the help."""
    items = []
    for names, text in rows:
        term = nodes.term("", "", nodes.literal(names, names))
        body = nodes.definition("", nodes.paragraph("", "", *words(" ".join(text.split()))))
        items.append(nodes.definition_list_item("", term, body))
    return nodes.definition_list("", *items)


def help_of(command: Any) -> str:
    """The help of a command, a paragraph per line."""
    text = inspect.cleandoc(command.help or "")
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def words(text: str) -> Iterable[nodes.Node]:
    """Text in which options and what stands in backticks are code, and pages are links."""
    end = 0
    for match in CODE.finditer(text):
        yield nodes.Text(text[end : match.start()])
        end = match.end()
        page = PAGE.fullmatch(match[0])
        yield reference(page[1]) if page else nodes.literal("", match[1] or match[0])
    yield nodes.Text(text[end:])


def reference(page: str) -> nodes.Node:
    """A link to a page, with its title."""
    target = {"refdomain": "std", "reftype": "doc", "reftarget": f"/{page}", "refwarn": True}
    return addnodes.pending_xref("", nodes.inline("", page), refexplicit=False, **target)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("command-line", CommandLine)
    return {"parallel_read_safe": True}

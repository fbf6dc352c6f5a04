"""The directive ``public-names``: a package's `__all__`, each name with its docstring."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

PAGE = re.compile(r"(?P<ticks>`{0,2})docs/(?P<page>[\w-]+)\.md(?P=ticks)")
FOOTNOTE = re.compile(r"\[(\d+)\](?=_)|(?<=^\.\. )\[(\d+)\]")


class PublicNames(SphinxDirective):
    """Documents each name of ``__all__``; one that another page has is only linked."""

    required_arguments = 1
    has_content = False

    def run(self) -> list[nodes.Node]:
        """Return the descriptions."""
        package = self.arguments[0]
        module = importlib.import_module(package)
        lines = [f".. py:module:: {package}", ""]
        lines += [*inspect.cleandoc(module.__doc__ or "").splitlines(), ""]
        elsewhere = []
        for name in module.__all__:
            home = self._home(package, name, getattr(module, name))
            if home == package:
                lines += described(package, name, getattr(module, name))
            else:
                elsewhere.append(f"`{home}.{name}`" if home else f"`{name}`")
        if elsewhere:
            lines += ["Names of another page: " + ", ".join(elsewhere) + ".", ""]
        return self.parse_text_to_nodes_of(lines)

    def parse_text_to_nodes_of(self, lines: list[str]) -> list[nodes.Node]:
        """Parse reStructuredText, whichever format the page has."""
        node = nodes.Element()
        self.state.nested_parse(StringList(lines, self.get_source_info()[0]), 0, node)
        return node.children

    def _home(self, package: str, name: str, item: Any) -> str:
        """The first package that has the same object under the same name."""
        for other in self.config.public_packages:
            known = importlib.import_module(other)
            if name in known.__all__ and getattr(known, name) is item:
                return other
        return package


def described(package: str, name: str, item: Any) -> list[str]:
    """The directives that document one name."""
    full = f"{package}.{name}"
    if inspect.ismodule(item):
        return []
    if inspect.isclass(item):
        return [f".. autoclass:: {full}", "   :members:", ""]
    if inspect.isroutine(item):
        return [f".. autofunction:: {full}", ""]
    return [f".. py:data:: {full}", f"   :type: {type(item).__name__}", ""]


def adapted(app: Sphinx, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Make links of the pages that a docstring names; number its footnotes apart from others."""
    label = re.sub(r"\W+", "-", name)
    for i, line in enumerate(lines):
        with_links = PAGE.sub(r":doc:`/\g<page>`", line)
        lines[i] = FOOTNOTE.sub(lambda found: f"[#{label}-{found[1] or found[2]}]", with_links)
    if what in ("attribute", "property"):
        lines[:0] = ["..", ""]  # else napoleon takes what is before a colon for the type


def plain_types(app: Sphinx, doctree: nodes.document) -> None:
    """Leave the words of types that are no public name: "shape" is no link to some attribute."""
    public = {
        name
        for package in app.config.public_packages
        for name in importlib.import_module(package).__all__
    }
    for link in list(doctree.findall(addnodes.pending_xref)):
        of_type = link["refdomain"] == "py" and link["reftype"] == "class"
        if of_type and link["reftarget"].split(".")[-1] not in public:
            link.replace_self(link.children)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_config_value("public_packages", [], "env")
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-docstring", adapted, priority=400)  # before napoleon
    app.connect("doctree-read", plain_types)
    return {"parallel_read_safe": True}

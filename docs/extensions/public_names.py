"""The directive ``public-names``: a package's `__all__`, each name with its docstring."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

PAGE = re.compile(r"(?P<ticks>`{0,2})docs/(?P<page>[\w-]+)\.md(?P=ticks)")
TYPE = re.compile(r"(\*\*[^*]+\*\*) \(\*(.+?)\*\)(?= --|$)")
SETTINGS = re.compile(r"samples_per_mm2=.*\)$")
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
        hidden = "   :exclude-members: model_config, model_post_init"  # of pydantic
        return [f".. autoclass:: {full}", "   :members:", hidden, ""]
    if inspect.isroutine(item):
        return [f".. autofunction:: {full}", ""]
    return [f".. py:data:: {full}", f"   :type: {type(item).__name__}", ""]


def adapted(app: Sphinx, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Make links of the pages and types that a docstring names; number its footnotes apart."""
    label = re.sub(r"\W+", "-", name)
    packages = map(importlib.import_module, app.config.public_packages)
    public = {public for package in packages for public in package.__all__}

    def linked(found: re.Match[str]) -> str:
        """A type, with links of its public classes: "shape" is none to some attribute."""
        words = re.sub(r"\b[A-Z]\w+", lambda w: f"`.{w[0]}`" if w[0] in public else w[0], found[2])
        return f"{found[1]} ({words})"

    for i, line in enumerate(lines):
        line = PAGE.sub(r":doc:`/\g<page>`", line)
        line = FOOTNOTE.sub(lambda found: f"[#{label}-{found[1] or found[2]}]", line)
        lines[i] = TYPE.sub(linked, line)


def whole(app: Sphinx, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Keep napoleon from taking what is before the first colon of a property for its type."""
    if what in ("attribute", "property"):
        lines[:0] = ["..", ""]


def short(
    app: Sphinx, what: str, name: str, item: Any, options: Any, signature: str | None, _: Any
) -> tuple[str, str] | None:
    """The signature without what is said elsewhere: defaults of a file's record, settings."""
    fields = getattr(item, "model_fields", None)
    if what == "function" and SETTINGS.search(signature or ""):
        return SETTINGS.sub("**fields)", signature or ""), ""
    return (f"(*, {', '.join(fields)})", "") if fields else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_config_value("public_packages", [], "env")
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-docstring", whole, priority=400)  # before napoleon's, of 500
    app.connect("autodoc-process-docstring", adapted)
    app.connect("autodoc-process-signature", short)
    return {"parallel_read_safe": True}

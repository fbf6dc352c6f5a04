"""Groups of options: a command takes one record for options that belong together.

A group is a dataclass whose fields are made by `option` and `argument`; they are the defaults of
single parameters of a command, too.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import Field, field, fields, is_dataclass
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

REQUIRED = Parameter.empty
"""The default of an option without which a command is wrong usage."""

UNITS = ("mm", "deg", "db", "hz", "us", "s")
"""Of names of options: the help shows them in place of the value."""


def wrong_usage(option: str, text: str) -> typer.BadParameter:
    """The error that names the option and ends in exit status 2."""
    return typer.BadParameter(text, param_hint=option)


def option(
    help: str,
    default: Any = None,
    *,
    kind: Callable[..., Any] = typer.Option,
    names: tuple[str, ...] = (),
    needs: str = "",
    without: str = "",
    panel: str = "",
    **details: Any,
) -> Any:
    """A field that is an option; without `names` ``edge_mm`` is ``--edge-mm``.

    In a command that has the option `needs` it goes with that one only, and never with those of
    `without`; the help shows it under the heading `panel`. `details` are those of `typer.Option`.
    """
    known = {"default": default, "names": names, "needs": needs, "without": without, "kind": kind}
    metadata = {**known, "panel": panel, "details": {"help": help, **details}}
    return field(metadata=metadata, **({} if default is REQUIRED else {"default": default}))


def argument(help: str, default: Any = None, **details: Any) -> Any:
    """A field that is a positional argument; `details` are those of `typer.Argument`."""
    return option(help, default, kind=typer.Argument, **details)


def output_option(help: str, default: Any = None, *names: str, **details: Any) -> Any:
    """A field that is the option ``-o``, ``--output``, and has other names, too."""
    return option(help, default, names=("-o", "--output", *names), panel="Output", **details)


def option_name(name: str, one: Field[Any]) -> str:
    """The name of the option of a field, or that which help gives an argument."""
    if one.metadata["kind"] is typer.Argument:
        return str(one.metadata["details"].get("metavar") or name.upper())
    return str((one.metadata["names"] or ("--" + name.replace("_", "-"),))[0])


def expanded(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command one keyword for each field of its groups: the parameters that typer reads."""
    shown = inspect.signature(command, eval_str=True)
    groups: dict[str, Any] = {
        n: p.annotation for n, p in shown.parameters.items() if is_dataclass(p.annotation)
    }
    declared: dict[str, Field[Any]] = {}
    parameters: list[Parameter] = []
    for name, parameter in shown.parameters.items():
        own, hints, panel = {name: parameter.default}, {name: parameter.annotation}, ""
        if name in groups:
            own, hints = {f.name: f for f in fields(groups[name])}, get_type_hints(groups[name])
            panel = getattr(groups[name], "PANEL", "")
        declared |= own
        parameters += [_parameter(n, hints[n], one, panel) for n, one in own.items()]

    def run(**values: Any) -> Any:
        _check_together(declared, values)
        records = {
            name: group(**{one.name: values.pop(one.name) for one in fields(group)})
            for name, group in groups.items()
        }
        return command(**records, **values)

    run.__signature__ = shown.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def _parameter(name: str, hint: Any, one: Field[Any], panel: str) -> Parameter:
    known, details = one.metadata, dict(one.metadata["details"])
    names, unit = known["names"], name.rpartition("_")[2]
    if known["kind"] is typer.Option:
        names = names or (option_name(name, one),)
        if unit in UNITS:
            details.setdefault("metavar", unit.upper())
        details["rich_help_panel"] = known["panel"] or panel or None
    annotation: Any = Annotated[hint, known["kind"](*names, **details)]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=known["default"], annotation=annotation)


def _check_together(declared: dict[str, Field[Any]], values: dict[str, Any]) -> None:
    names = {name: option_name(name, one) for name, one in declared.items()}
    there = {names[n] for n, f in declared.items() if values[n] not in (f.metadata["default"], [])}
    for name, one in declared.items():
        needs, without = one.metadata["needs"], one.metadata["without"]
        if names[name] not in there:
            continue
        if needs in names.values() and needs not in there:
            raise wrong_usage(names[name], f"expected {needs} with it")
        for other in without.split():
            if other in there:
                raise wrong_usage(names[name], f"expected without {other}")


def given(group: Any) -> dict[str, Any]:
    """The options of a group that are not at their default: name -> value."""
    values = {one: getattr(group, one.name) for one in fields(group)}
    return {option_name(f.name, f): value for f, value in values.items() if value != f.default}


def recorded(*groups: Any, **options: Any) -> dict[str, Any]:
    """The options of groups, and single ones, in types that JSON reads back as they were."""
    values = {one.name: getattr(group, one.name) for group in groups for one in fields(group)}
    return {name: _plain(value) for name, value in {**values, **options}.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value

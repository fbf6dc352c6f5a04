"""Groups of options: a command takes one record for options that belong together.

A group is a dataclass whose fields are made by `option` and `argument`; they are the defaults of
single parameters of a command, too.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import Field, field, fields, is_dataclass
from enum import Enum
from inspect import Parameter
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import typer

REQUIRED = Parameter.empty
"""The default of an option without which a command is wrong usage."""


def option(default: Any, help: str, *, names: tuple[str, ...] = (), **details: Any) -> Any:
    """A field that is an option; without `names` ``edge_mm`` is ``--edge-mm``.

    `details` are those of `typer.Option`.
    """
    return _field(default, lambda name: typer.Option(*names or (name,), help=help, **details))


def output_option(default: Any, help: str, **details: Any) -> Any:
    """A field that is the option ``-o``, ``--output``."""
    return option(default, help, names=("-o", "--output"), **details)


def option_name(field: str) -> str:
    """The name of the option of a field."""
    return "--" + field.replace("_", "-")


def argument(default: Any, help: str, **details: Any) -> Any:
    """A field that is a positional argument; `details` are those of `typer.Argument`."""
    return _field(default, lambda _: typer.Argument(help=help, **details))


def _field(default: Any, declared: Callable[[str], Any]) -> Any:
    given = {} if default is REQUIRED else {"default": default}
    return field(metadata={"default": default, "declared": declared}, **given)


def expanded(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command one keyword for each field of its groups: the parameters that typer reads."""
    shown = inspect.signature(command, eval_str=True)
    groups: dict[str, Any] = {}
    parameters: list[Parameter] = []
    for name, parameter in shown.parameters.items():
        if is_dataclass(parameter.annotation):
            groups[name] = parameter.annotation
            parameters += _parameters_of(parameter.annotation)
        else:
            parameters.append(_parameter(name, parameter.annotation, parameter.default))

    def run(**values: Any) -> Any:
        chosen = {name: _chosen(value) for name, value in values.items()}
        records = {
            name: group(**{field.name: chosen.pop(field.name) for field in fields(group)})
            for name, group in groups.items()
        }
        return command(**records, **chosen)

    run.__signature__ = shown.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def _parameters_of(group: Any) -> list[Parameter]:
    hints = get_type_hints(group)
    return [_parameter(one.name, hints[one.name], one) for one in fields(group)]


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    if isinstance(default, Field):
        declared = default.metadata["declared"](option_name(name))
        default = default.metadata["default"]
    else:
        hint, declared = get_args(hint)  # of Annotated
    annotation: Any = Annotated[_type_for_typer(hint), declared]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _type_for_typer(hint: Any) -> Any:
    """The same type with an enumeration for each literal; the typers before 0.19 know none."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Literal:
        return Enum("Choice", {value: value for value in arguments}, type=str)
    if origin in (Union, UnionType):
        return Union[tuple(map(_type_for_typer, arguments))]  # noqa: UP007
    return list[_type_for_typer(arguments[0])] if origin is list else hint  # type: ignore[misc]


def _chosen(value: Any) -> Any:
    """A value of typer in the type that the field has."""
    if isinstance(value, list):
        return [_chosen(item) for item in value]
    return value.value if isinstance(value, Enum) else value


def given(group: Any) -> dict[str, Any]:
    """The options of a group that are not at their default: name -> value."""
    values = {field: getattr(group, field.name) for field in fields(group)}
    return {option_name(f.name): value for f, value in values.items() if value != f.default}


def recorded(*groups: Any, **options: Any) -> dict[str, Any]:
    """The options of groups, and single ones, in types that JSON reads back as they were."""
    values = {field.name: getattr(group, field.name) for group in groups for field in fields(group)}
    return {name: _plain(value) for name, value in {**values, **options}.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value

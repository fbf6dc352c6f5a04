"""Groups of options: a command takes one record for options that belong together.

A group is a dataclass whose fields are made by `option` and `argument`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from copy import copy
from dataclasses import field, fields, is_dataclass
from enum import Enum
from inspect import Parameter
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_type_hints

import typer

REQUIRED = Parameter.empty
"""The default of an option without which a command is wrong usage."""


def option(default: Any, help: str, *, names: tuple[str, ...] = (), **details: Any) -> Any:
    """A field that is an option; without `names` ``edge_mm`` is ``--edge-mm``.

    `details` are those of `typer.Option`.
    """
    return _field(default, lambda name: typer.Option(*names or (name,), help=help, **details))


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
            hint, declared = get_args(parameter.annotation)
            parameters.append(_parameter(name, parameter.default, hint, declared))

    def run(**values: Any) -> Any:
        records = {
            name: group(**{field.name: values.pop(field.name) for field in fields(group)})
            for name, group in groups.items()
        }
        return command(**records, **values)

    run.__signature__ = shown.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def _parameters_of(group: Any) -> list[Parameter]:
    hints = get_type_hints(group)
    parameters = []
    for one in fields(group):
        declared = one.metadata["declared"](option_name(one.name))
        default = one.metadata["default"]
        parameters.append(_parameter(one.name, default, hints[one.name], declared))
    return parameters


def _parameter(name: str, default: Any, hint: Any, declared: Any) -> Parameter:
    if isinstance(hint, UnionType):  # typer 0.12 knows Optional[str], but not str | None
        hint = Union[get_args(hint)]  # noqa: UP007
    # A copy: for the same object Python 3.10 would return its cached Annotated[str | None, ...].
    annotation = Annotated[hint, copy(declared)]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def recorded(*groups: Any, **options: Any) -> dict[str, Any]:
    """The options of groups, and single ones, in types that JSON reads back as they were."""
    values = {field.name: getattr(group, field.name) for group in groups for field in fields(group)}
    return {name: _plain(value) for name, value in {**values, **options}.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Path):
        return str(value)
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value

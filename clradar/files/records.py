"""Records from TOML and JSON files: frozen pydantic models, all mistakes of a file at once.

A mistake is a line "file: key: expected ..., got ...". Modules that hold such models are imported
when a file is read: pydantic takes longer to import than all of `import clradar`.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from clradar.errors import ClradarError, MeasurementError, ModelError, quoted
from clradar.files.failures import clean, shown
from clradar.files.json_file import read_json
from clradar.files.toml_file import choice_text, read_toml, toml_brief, unknown_key

Model = TypeVar("Model", bound=BaseModel)
Made = TypeVar("Made")

LONGEST = 1e15
"""Decimal numbers below this are shown as the whole number to write instead."""

MOST_MISTAKES = 20
"""That the text of an error lists."""

_KEY_CHARACTERS = 80

_TYPE = re.compile(r"\[(all|key)\]|[a-z-]+\[.*\]")
"""What pydantic adds to the keys that lead to a value, or `UNNAMED` of plans."""


class FileRecord(BaseModel):
    """A table of a file; a key that it does not know is a mistake."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


class OpenRecord(FileRecord):
    """A table of a file that may have other keys, which are passed over."""

    model_config = ConfigDict(extra="ignore")


def mistake(expected: str, got: object = None, *, key: Any = "") -> PydanticCustomError:
    """Return what a validator raises; without `got` it is the value, `key` names an inner place."""
    if got is not None:  # pydantic refuses half of a surrogate pair, which JSON can hold
        text = got if isinstance(got, str) else toml_brief(got)
        got = text.encode("utf-8", "backslashreplace").decode()
    return PydanticCustomError(
        "mistake", "{expected}", {"expected": expected, "got": got, "key": key}
    )


def made(call: Callable[..., Made], *args: Any, **fields: Any) -> Made:
    """Return `call(...)`; a `ModelError`, which may name record and field, is a mistake there."""
    try:
        return call(*args, **fields)
    except ModelError as error:
        found = re.fullmatch(r"(?:\w*\.)?(\w+): (expected .*)", str(error), re.DOTALL)
        key, text = found.groups() if found else ("", str(error))
        raise PydanticCustomError("said", "{text}", {"text": clean(text), "key": key}) from error


def is_number(value: object) -> bool:
    """Whether a value of TOML or JSON is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300  # an int of any length, or an infinity, is larger; NaN is not less


def is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def checked(expected: str, good: Callable[[Any], bool], made: Callable[[Any], Any]) -> Any:
    """Return an annotation: a value for which `good` holds, as `made` of it."""

    def check(value: Any) -> Any:
        if not good(value):
            raise mistake(expected)
        return made(value)

    return BeforeValidator(check)


def _whole(value: Any) -> int:
    if isinstance(value, float) and value.is_integer() and abs(value) < LONGEST:
        raise mistake("a whole number", f"the decimal number {value!r}; write {int(value)}")
    if not is_whole(value):
        raise mistake("a whole number")
    return int(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and 0 < len(value) <= 1000 and "\0" not in value


def number_tuple(
    value: Any, expected: str, counts: Sequence[int], *above: int
) -> tuple[float, ...]:
    """Return a list of numbers; a mistake names the first that is none, by its place."""
    if not isinstance(value, list | tuple) or not value or (counts and len(value) not in counts):
        raise mistake(expected, key=above)
    for i, number in enumerate(value):
        if not is_number(number):
            raise mistake("a finite number", toml_brief(number), key=(*above, i))
    return tuple(map(float, value))


def row_tuple(value: Any) -> tuple[tuple[float, ...], ...]:
    expected = "a list of rows of numbers, all as long as each other"
    if not isinstance(value, list) or not value or not isinstance(value[0], list):
        raise mistake(expected)
    return tuple(number_tuple(row, expected, [len(value[0])], i) for i, row in enumerate(value))


def text(expected: str) -> Any:
    """Return the annotation of a text that is not empty."""
    return checked(expected, _is_text, str)


Number = Annotated[float, checked("a finite number", is_number, float)]
Whole = Annotated[int, BeforeValidator(_whole)]
Text = Annotated[str, text("text")]
NumberOrText = Annotated[
    float | str, checked("a number or text", lambda v: is_number(v) or _is_text(v), lambda v: v)
]
Rows = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(row_tuple)]
Numbers = Annotated[
    tuple[float, ...], BeforeValidator(lambda value: number_tuple(value, "a list of numbers", ()))
]


def numbers(*counts: int) -> Any:
    """Return the annotation of a list of as many numbers as one of `counts`."""
    expected = f"a list of {' or '.join(map(str, counts))} numbers"
    return BeforeValidator(lambda value: number_tuple(value, expected, counts))


Vector = Annotated[tuple[float, ...], numbers(3)]


def one_of(*choices: str) -> Any:
    """Return the annotation of a text that is one of `choices`."""

    def check(value: Any) -> Any:
        if not isinstance(value, str) or value not in choices:
            raise mistake(choice_text(value, choices))
        return value

    return BeforeValidator(check)


def read_record(
    path: Path, model: type[Model], expected: str, error: type[ClradarError] = MeasurementError
) -> Model:
    """Return the record in a file: JSON if its name ends in .json, else TOML."""
    read: Any = read_json if path.suffix.lower() == ".json" else read_toml
    return record_of(read(path, expected, error=error), model, path, error=error)


def record_of(
    parsed: Any,
    model: type[Model],
    source: str | Path,
    *,
    place: str = "",
    error: type[ClradarError] = MeasurementError,
    context: Any = None,
) -> Model:
    """Return the record of a parsed table; `source` and `place` are its file and key."""
    try:
        return model.model_validate(parsed, context=context)
    except ValidationError as found:
        errors = found.errors(include_url=False)
        lines = [line for one in errors for line in _lines(one, model, shown(source), place)]
    raise_mistakes(lines, error)  # by itself: what pydantic found may not be pickled


def raise_mistakes(lines: Sequence[str], error: type[ClradarError] = MeasurementError) -> NoReturn:
    """Raise the error of one mistake, or of several with their number and a line for each."""
    text = list(lines[:MOST_MISTAKES])
    if len(lines) > 1:
        text.insert(0, f"{len(lines)} mistakes, one per line:")
    if len(lines) > MOST_MISTAKES:
        text.append(f"and {len(lines) - MOST_MISTAKES} more")
    failure = error("\n".join(text))
    failure.mistakes = tuple(lines)
    raise failure


def _lines(found: Any, model: type[BaseModel], source: str, above: str) -> list[str]:
    kind, context = found["type"], found.get("ctx", {})
    key = found["loc"][-1:] if kind == "extra_forbidden" else ()
    loc = [part for part in found["loc"] if part in key or not _TYPE.fullmatch(str(part))]
    inner = context.get("key") or ()
    place = _place(above, [*loc, *([inner] if isinstance(inner, str) else inner)])
    start = f"{source}: {place}: " if place else f"{source}: "
    if kind == "said":  # of another file several
        return [start + text for text in context["text"].splitlines()]
    owner, field = _field(model, found["loc"])
    if kind == "extra_forbidden" and owner is not None:
        return [start + unknown_key(loc[-1], list(owner.model_fields))]
    expected, got = _expected(kind, context), context.get("got")
    if kind == "literal_error":
        expected = choice_text(found["input"], re.findall("'([^']*)'", context["expected"]))
    if kind == "missing":
        expected = "a value" if _model_in(field.annotation) is None else "a table"
    if kind != "mistake" and (described := getattr(field, "description", None)):
        expected = described
    if got is None:
        got = "nothing" if kind == "missing" else toml_brief(found["input"])
    return [f"{start}expected {expected}, got {quoted(got)}"]


_LIMITS = {"gt": "above", "ge": "from", "lt": "below", "le": "at most"}


def _expected(kind: str, context: dict[str, Any]) -> str:
    if kind == "mistake":
        return str(context["expected"])
    for name, words in _LIMITS.items():
        if name in context:
            return f"a number {words} {context[name]:g}"
    if kind.startswith("bool"):
        return "true or false"
    if kind.startswith(("tuple", "list")):
        return "a list"
    if kind.startswith(("model", "dict", "dataclass")):
        return "a table or object"
    if kind.startswith("string"):
        return "text"
    if kind in ("too_long", "too_short"):
        least, most = context.get("min_length"), context.get("max_length")
        return f"at least {least} entries" if most is None else f"at most {most} entries"
    return clean(context.get("error", kind))


def _place(above: str, loc: Sequence[Any]) -> str:
    place = quoted(above, _KEY_CHARACTERS)
    for part in loc:
        if isinstance(part, int):
            place += f"[{part}]"
        else:
            place += f".{quoted(part, _KEY_CHARACTERS)}" if place else quoted(part, _KEY_CHARACTERS)
    return place


def _field(model: Any, loc: Sequence[Any]) -> tuple[type[BaseModel] | None, Any]:
    """Return the model and the field of a place; None where it is none of a model."""
    owner: type[BaseModel] | None = model
    field, is_key = None, False
    for at, part in enumerate(loc):
        if is_key:
            field, is_key = None, False
            continue
        if isinstance(part, int) or owner is None:
            continue
        fields = owner.model_fields
        alias = (f for f in fields.values() if part in getattr(f.validation_alias, "choices", ()))
        field = fields.get(part) or next(alias, None)
        if at + 1 < len(loc):
            is_key = field is not None and get_origin(field.annotation) is dict
            owner = None if field is None else _model_in(field.annotation)
    return owner, field


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model that a field holds, alone, optional or in a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (Union, types.UnionType, list, tuple, Annotated, dict):
        found = (_model_in(part) for part in get_args(annotation))
        return next((model for model in found if model is not None), None)
    return None

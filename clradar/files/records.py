"""Records from TOML and JSON files: frozen pydantic models, all mistakes of a file at once.

A mistake is a line "file: key: expected ..., got ...". Modules that hold such models are imported
when a file is read: pydantic takes longer to import than all of `import clradar`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from clradar.errors import ClradarError, MeasurementError, ModelError, quoted
from clradar.files.failures import clean, shown
from clradar.files.json_file import read_json
from clradar.files.toml_file import choice_text, read_toml, toml_brief, unknown_key

Model = TypeVar("Model", bound=BaseModel)
Made = TypeVar("Made")

MOST_MISTAKES = 20  # that the text of an error lists
_KEY_CHARACTERS = 80

_TYPE = re.compile(r"\[(all|key)\]|[a-z-]+\[.*\]")
"""What pydantic adds to the keys that lead to a value, or `UNNAMED` of plans."""


class FileRecord(BaseModel):
    """A table of a file; a key that it does not know is a mistake."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    @model_validator(mode="wrap")
    @classmethod
    def _in_words(cls, value: Any, handler: Any) -> Any:
        """Word mistakes of fields, where these are known; of the whole it is the field's above."""
        try:
            return handler(value)
        except ValidationError as error:
            found = error.errors(include_url=False)
        lines: Any = [_worded(cls, one) if one["loc"] else one for one in found]
        raise ValidationError.from_exception_data(cls.__name__, lines)


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


def checked(
    expected: str | Callable[[Any], str], good: Callable[[Any], bool], when: Any = BeforeValidator
) -> Any:
    """Return an annotation: a value for which `good` holds, before or after it has its type."""

    def check(value: Any) -> Any:
        if not good(value):
            raise mistake(expected(value) if callable(expected) else expected)
        return value

    return when(check)


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and 0 < len(value) <= 1000 and "\0" not in value


def text(expected: str) -> Any:
    """Return the annotation of a text that is not empty."""
    return checked(expected, _is_text)


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
Text = Annotated[str, text("text")]
NumberOrText = Annotated[
    float | str, checked("a number or text", lambda v: is_number(v) or _is_text(v))
]
Vector = tuple[Number, Number, Number]
Numbers = Annotated[
    tuple[Number, ...],
    Field(fail_fast=True),
    checked("a list of numbers", lambda v: isinstance(v, list | tuple) and len(v) > 0),
]
Rows = Annotated[
    tuple[Numbers, ...],
    Field(fail_fast=True),
    checked("rows as long as each other", lambda v: len({*map(len, v)}) == 1, AfterValidator),
]


def one_of(*choices: str) -> Any:
    """Return the annotation of a text that is one of `choices`."""
    return checked(lambda value: choice_text(value, choices), lambda value: value in choices)


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
        errors = [_worded(model, one) for one in found.errors(include_url=False)]
        lines = [line for one in errors for line in _lines(one, shown(source), place)]
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


def _lines(found: Any, source: str, above: str) -> list[str]:
    context = found["type"].context
    loc = [above, *(part for part in found["loc"] if not _TYPE.fullmatch(str(part)))]
    inner = context.get("key") or ()
    loc += [inner] if isinstance(inner, str) else inner
    keys = (f"[{k}]" if isinstance(k, int) else f".{quoted(k, _KEY_CHARACTERS)}" for k in loc)
    place = "".join(keys).removeprefix(".").removeprefix(".")  # of the table and of the key
    start = f"{source}: {place}: " if place else f"{source}: "
    if "text" in context:  # of another file several
        return [start + text for text in context["text"].splitlines()]
    got = toml_brief(found["input"]) if context["got"] is None else context["got"]
    return [f"{start}expected {context['expected']}, got {quoted(got)}"]


def _worded(model: type[BaseModel], found: Any) -> Any:
    """Return what pydantic found in a table of `model` as a mistake."""
    kind, loc, context = found["type"], found["loc"], found.get("ctx", {})
    field: Any = None
    if not any(isinstance(part, str) and not _TYPE.fullmatch(part) for part in loc[1:]):
        for name, own in model.model_fields.items():  # not of a mapping's values
            if loc and loc[0] in (name, *getattr(own.validation_alias, "choices", ())):
                field = own
    if kind in ("mistake", "said"):
        error = PydanticCustomError(kind, "{}", context)
    elif kind == "extra_forbidden":
        text, loc = unknown_key(loc[-1], list(model.model_fields)), loc[:-1]
        error = PydanticCustomError("said", "{}", {"text": text, "key": found["loc"][-1:]})
    else:
        expected, got = _expected(found), None
        if kind == "missing":
            is_table = field is not None and hasattr(field.annotation, "model_fields")
            expected, got = "a table" if is_table else "a value", "nothing"
        error = mistake(getattr(field, "description", None) or expected, got)
    return {"type": error, "loc": loc, "input": found["input"]}


_FORM = re.compile(
    r"^\w+ should (be|have) | after validation|, unable to .*| or instance of \w+| \(.*\)$"
)
"""What a text of pydantic has beside what is expected."""


def _expected(found: Any) -> str:
    if found["type"] == "literal_error":
        return choice_text(found["input"], re.findall("'([^']*)'", found["ctx"]["expected"]))
    text = clean(_FORM.sub("", found["msg"]))
    return text.replace("tuple", "list").replace("valid dictionary", "table or object")

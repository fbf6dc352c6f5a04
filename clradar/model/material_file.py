"""Files of materials: TOML or JSON, a table for each; format in ``docs/materials.md``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from clradar.errors import MeasurementError, ModelError, OutputError, quoted
from clradar.files.atomic import write_file
from clradar.files.failures import fail, read_bytes, reading, shown
from clradar.files.json_file import indented, parse_object
from clradar.files.limits import MAX_TOML_BYTES
from clradar.files.toml_file import parse_toml, toml_brief, toml_document, unknown_key
from clradar.model import checks
from clradar.model.material import Coating, Material
from clradar.model.permittivity import ColeCole, PermittivityTable, PowerLaw

SUFFIXES = (".toml", ".json")

_NAME = f"a name that ends in {' or '.join(SUFFIXES)}"
_EXPECTED = "materials (a TOML or JSON file, see docs/materials.md)"
_KINDS: dict[str, type] = {
    "eps_inf": ColeCole,
    "a": PowerLaw,
    "frequency_hz": PermittivityTable,
}
"""Key that a table of a permittivity has -> its record."""

_PERMITTIVITY = (
    'a number, text such as "2.9 - 0.04j", or a table with eps_inf, with a, or with frequency_hz'
)

Made = TypeVar("Made")


def read_materials(path: str | os.PathLike[str]) -> dict[str, Material]:
    """Return the materials of a .toml or .json file by name, in its order (docs/materials.md).

    Raises
    ------
    MeasurementError
        The file or a value is invalid; the message names file, key, expected and found.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("lab.toml").write_text('[resin]\\npermittivity = "2.9 - 0.04j"\\n')
    >>> clradar.read_materials("lab.toml")["resin"].permittivity
    (2.9-0.04j)
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        fail(path, _NAME, f"'{path.name}'")
    content = read_bytes(path, _EXPECTED, MAX_TOML_BYTES)
    with reading(path, _EXPECTED):
        text = content.decode("utf-8-sig")
        parsed = parse_object(text) if path.suffix.lower() == ".json" else parse_toml(text)
    if not parsed:
        fail(path, "a table for each material", "nothing")
    found, mistakes = {}, []
    for name, table in parsed.items():
        try:
            found[name] = _made_of((shown(path), name), table, Material, name=name)
        except MeasurementError as error:
            mistakes.append(str(error))
    if mistakes:
        from clradar.files.records import raise_mistakes

        raise_mistakes(mistakes)
    return found


def write_materials(
    path: str | os.PathLike[str], materials: Iterable[Material], *, force: bool = False
) -> None:
    """Write materials to a .toml or .json file; reading it gives them again, to the last bit.

    Parameters
    ----------
    path : path-like
        In an existing folder.
    materials : iterable of Material
        With different names.
    force : bool
        Replace an existing file.

    Examples
    --------
    >>> clradar.write_materials("known.toml", [clradar.material("palm")])
    >>> clradar.read_materials("known.toml")["palm"] == clradar.material("palm")
    True
    """
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{shown(target)}: expected {_NAME}, got '{target.suffix}'")
    if isinstance(materials, str | Mapping) or not isinstance(materials, Iterable):
        checks.fail("write_materials: materials", "a list of materials", type(materials).__name__)
    content: dict[str, Any] = {}
    for material in materials:
        checks.instance("write_materials: materials", material, Material)
        record = material_record(material)
        if material.name in content:
            checks.fail("write_materials", "different names", f"{material.name!r} twice")
        content[record.pop("name")] = record
    text = indented(content) if target.suffix.lower() == ".json" else toml_document(content)
    write_file(target, text.encode(), force=force)


def material_record(own: Any) -> dict[str, Any]:
    """Return a material, or a part of one, as values of TOML or JSON, without defaults."""
    values = {f.name: (getattr(own, f.name), f.default) for f in fields(own)}
    return {name: _plain(value) for name, (value, default) in values.items() if value != default}


def material_of(record: Mapping[str, Any], source: str = "material") -> Material:
    """Return the material of a `material_record`; `source` is named in messages."""
    return _made_of((source,), dict(record), Material)


def _plain(value: Any) -> Any:
    if isinstance(value, Coating | ColeCole | PowerLaw | PermittivityTable):
        return material_record(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, complex):
        return value.real if value.imag == 0 else str(value).strip("()")
    return value


def _words(place: Sequence[str]) -> str:
    """Return file and keys."""
    return ": ".join(filter(None, [place[0], ".".join(quoted(k, 80) for k in place[1:] if k)]))


def _fail(place: Sequence[str], expected: str, got: Any) -> NoReturn:
    words = got if isinstance(got, str) else toml_brief(got)
    raise MeasurementError(f"{_words(place)}: expected {expected}, got {quoted(words)}")


def _made_of(place: Sequence[str], content: Any, kind: type[Made], **given: Any) -> Made:
    """Return the record whose fields are the keys of a table, but for those that are given."""
    if not isinstance(content, dict):
        _fail(place, "a table or object", content)
    own: list[Any] = [f for f in fields(kind) if f.name not in given]  # type: ignore[arg-type]
    known = [f.name for f in own]
    for key, value in content.items():
        if key in given:
            _fail((*place, key), f"no such key: a table's {key} is the material's", value)
        if key not in known:
            raise MeasurementError(f"{_words((*place, key))}: {unknown_key(key, known)}")
    values = {key: _value((*place, key), content[key]) for key in known if key in content}
    for name in (f.name for f in own if f.default is MISSING and f.name not in values):
        _fail((*place, name), "a value", "none")
    try:
        return kind(**given, **values)
    except ModelError as error:
        remark = str(error).removeprefix(kind.__name__)  # a reader looks for a table and a key
        remark = remark if any(place[1:]) else f": {remark.lstrip('.: ')}"
        raise MeasurementError(f"{_words(place)}{remark}") from error


def _value(place: Sequence[str], value: Any) -> Any:
    if place[-1] == "coating":
        return _made_of(place, value, Coating)
    if place[-1] != "permittivity" or not isinstance(value, str | list | dict):
        return value
    if isinstance(value, list):
        return [_value(place, item) for item in value]
    if isinstance(value, dict):
        kind = next((_KINDS[name] for name in _KINDS if name in value), None)
        return _fail(place, _PERMITTIVITY, value) if kind is None else _made_of(place, value, kind)
    try:
        return complex(value.replace(" ", ""))
    except ValueError:
        _fail(place, _PERMITTIVITY, toml_brief(value))

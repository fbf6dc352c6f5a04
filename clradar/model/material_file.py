"""Files of materials: TOML or JSON, a table for each; format in ``docs/materials.md``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

from clradar.errors import MeasurementError, ModelError, OutputError
from clradar.files.atomic import write_file
from clradar.files.failures import fail, read_bytes, reading, shown
from clradar.files.json_text import indented, parse_object
from clradar.files.limits import MAX_TOML_BYTES
from clradar.files.table import StrictTable
from clradar.files.toml_file import parse_toml, toml_document
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
    """Return the materials of a file whose name ends in .toml or .json, in its order.

    Raises
    ------
    MeasurementError
        Missing, too large, neither TOML nor JSON, no material in it, an unknown key, an invalid
        value. The message names the file, the key, what was expected, what was found.

    Examples
    --------
    >>> from pathlib import Path
    >>> import clradar
    >>> text = '[resin]\\npermittivity = "2.9 - 0.04j"\\nroughness_rms_m = 0.05e-3\\n'
    >>> _ = Path("lab.toml").write_text(text + 'correlation_length_m = 2e-3\\n')
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
            found[name] = _material(str(path), name, table)
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
        Target. Its folder has to exist.
    materials : iterable of Material
        With different names.
    force : bool
        Replace an existing file.

    Raises
    ------
    ModelError
        Not a list of materials, or two of one name.
    OutputError
        The file exists, its folder does not, or it cannot be written.

    Examples
    --------
    >>> import clradar
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
        name = (record := material_record(material)).pop("name")
        if name in content:
            raise ModelError(f"write_materials: expected different names, got {name!r} twice")
        content[name] = record
    text = (indented if target.suffix.lower() == ".json" else toml_document)(content)
    write_file(target, text.encode(), force=force)


def material_record(own: Any) -> dict[str, Any]:
    """Return a material, or a part of one, as values of TOML or JSON, without defaults."""
    values = {f.name: (getattr(own, f.name), f.default) for f in fields(own)}
    return {name: _plain(value) for name, (value, default) in values.items() if value != default}


def material_of(record: Mapping[str, Any], source: str = "material") -> Material:
    """Return the material of a `material_record`; `source` is named in messages."""
    return _made_of(StrictTable(source, "", dict(record)), Material)


def _plain(value: Any) -> Any:
    if isinstance(value, Coating | ColeCole | PowerLaw | PermittivityTable):
        return material_record(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, complex):
        return value.real if value.imag == 0 else str(value).strip("()")
    return value


def _material(source: str, name: str, content: Any) -> Material:
    table = StrictTable(source, name, content)
    if table.has("name"):
        table.fail("name", "no such key: a table's name is the material's", table.raw("name"))
    return _made_of(table, Material, name=name)


def _made_of(table: StrictTable, kind: type[Made], **given: Any) -> Made:
    """Return the record whose fields are the keys of a table."""
    known = [f.name for f in fields(kind) if f.name not in given]  # type: ignore[arg-type]
    table.done(known)
    values = {key: _value(table, key) for key in known if table.has(key)}
    for own in fields(kind):  # type: ignore[arg-type]
        if own.default is MISSING and own.name not in {**given, **values}:
            table.fail(own.name, "a value", "none")
    try:
        return kind(**given, **values)
    except ModelError as error:
        # The record names its class and field; a file's reader looks for a table and a key.
        table.fail_with(str(error).removeprefix(kind.__name__))


def _value(table: StrictTable, key: str) -> Any:
    value = table.raw(key)
    if key == "coating":
        return _made_of(table.table(key), Coating)
    if key != "permittivity":
        return value
    if isinstance(value, list):
        return [_number(table, key, item) for item in value]
    if not isinstance(value, dict):
        return _number(table, key, value)
    kind = next((_KINDS[name] for name in _KINDS if name in value), None)
    if kind is None:
        table.fail(key, _PERMITTIVITY, value)
    return _made_of(table.table(key), kind)


def _number(table: StrictTable, key: str, value: Any) -> Any:
    """Return text as a complex number, and what is none as it is: the record checks it."""
    if not isinstance(value, str):
        return value
    try:
        return complex(value.replace(" ", ""))
    except ValueError:
        table.fail(key, _PERMITTIVITY, value)

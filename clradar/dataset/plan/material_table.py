"""The key `material` of a plan: what the parts of a hand are made of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clradar.constants import (
    PLAUSIBLE_COATING_M,
    PLAUSIBLE_CORRELATION_M,
    PLAUSIBLE_ROUGHNESS_M,
)
from clradar.dataset.plan.draws import fixed
from clradar.dataset.plan.plan import PartMaterial, PlanMaterials
from clradar.dataset.plan.table import PlanTable
from clradar.hand import PART_NAMES
from clradar.model.known_materials import KNOWN, material
from clradar.model.material import Material
from clradar.model.material_file import SUFFIXES, material_of, read_materials

DEFAULT = "palm"
"""Most of what a radar sees of a hand that is held towards it."""

LIMITS_M = {
    "roughness_rms": (0.0, PLAUSIBLE_ROUGHNESS_M[1]),
    "correlation_length": PLAUSIBLE_CORRELATION_M,
    "coating_thickness": PLAUSIBLE_COATING_M,
}
"""Least and greatest value of what may be drawn, metres; the keys of a plan end in `_mm`."""


def materials_of(top: PlanTable, folder: Path) -> PlanMaterials:
    """Return the materials of a plan; files are relative to `folder`."""
    given = top.raw("material", DEFAULT)
    names = (*PART_NAMES, "others")
    if not isinstance(given, dict) or (given and not any(name in names for name in given)):
        return PlanMaterials({}, _part(top, "material", folder))
    table = top.table("material")
    others = _part(table, "others", folder)
    parts = {name: _part(table, name, folder) for name in PART_NAMES if table.has(name)}
    table.done(PART_NAMES)
    return PlanMaterials(parts, others)


def _part(above: PlanTable, key: str, folder: Path) -> PartMaterial:
    content = above.raw(key, DEFAULT)
    if not isinstance(content, dict):
        return PartMaterial(_made_of(above, key, content, folder))
    table = above.table(key)
    own = _made_of(table, "of", table.raw("of", DEFAULT), folder)
    drawn = {
        f"{name}_mm": table.draw(f"{name}_mm", fixed(1e3 * low_m), 1e3 * low_m, 1e3 * high_m)
        for name, (low_m, high_m) in LIMITS_M.items()
        if table.has(f"{name}_mm")
    }
    if "coating_thickness_mm" in drawn and own.coating is None:
        table.mistake("coating_thickness_mm", "a material with a coating", repr(own.name))
        del drawn["coating_thickness_mm"]
    found = PartMaterial(own, **drawn)
    table.checked("", found.extremes)
    table.done([f"{name}_mm" for name in LIMITS_M])
    return found


def _made_of(table: PlanTable, key: str, given: Any, folder: Path) -> Material:
    """Return the material of a name, ``FILE.toml:NAME``, or a table as in a file of materials."""
    default = material(DEFAULT)
    if isinstance(given, dict):
        return table.checked(key, material_of, given, table.place(key)) or default
    if not isinstance(given, str):
        table.refuse(key, "the name of a material, FILE.toml:NAME, or a table", given)
        return default
    file, colon, name = given.rpartition(":")
    known = KNOWN
    if colon and file.lower().endswith(SUFFIXES):
        known = table.checked(key, read_materials, folder / file) or {name: default}
    else:
        name = given
    if name not in known:
        table.refuse(key, f"one of {', '.join(known)}, or FILE.toml:NAME", given)
        return default
    return known[name]

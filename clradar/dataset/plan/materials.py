"""The key `material` of a plan: what the parts of a hand are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

from pydantic import BeforeValidator, ValidationInfo, model_validator

from clradar.constants import PLAUSIBLE_COATING_M, PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.dataset.plan.hands import folder_of
from clradar.dataset.plan.values import Draw, Value, draws, tried
from clradar.files.records import FileRecord, mistake
from clradar.files.toml_file import toml_brief
from clradar.hand import PART_NAMES
from clradar.model.known_materials import KNOWN, material
from clradar.model.material import Material
from clradar.model.material_file import SUFFIXES, material_of, read_materials

DEFAULT = "palm"
"""Most of what a radar sees of a hand that is held towards it."""

LENGTHS = ("roughness_rms_mm", "correlation_length_mm", "coating_thickness_mm")
"""What may be drawn."""


def _made_of(given: Any, info: ValidationInfo) -> Material:
    """Return the material of a name, ``FILE.toml:NAME``, or a table as in a file of materials."""
    if isinstance(given, Material):
        return given
    if isinstance(given, dict):
        made: Material = tried(material_of, given, "material")
        return made
    expected = "the name of a material, FILE.toml:NAME, or a table"
    if not isinstance(given, str):
        raise mistake(expected, toml_brief(given))
    file, colon, name = given.rpartition(":")
    known: Mapping[str, Material] = KNOWN
    if colon and file.lower().endswith(SUFFIXES):
        known = tried(read_materials, folder_of(info) / file)
    else:
        name = given
    if name not in known:
        raise mistake(f"one of {', '.join(known)}, or FILE.toml:NAME", toml_brief(given))
    return known[name]


_MATERIAL = {"anyOf": [{"type": "string"}, {"type": "object"}]}


def _millimetres(low_m: float, high_m: float) -> Value:
    return draws(1e3 * low_m, 1e3 * high_m)


class PartMaterial(FileRecord):
    """What a part of a hand is made of: a material, of which some lengths may be drawn."""

    of: Annotated[Material, Value(_made_of, _MATERIAL, True)] = material(DEFAULT)
    roughness_rms_mm: Annotated[Draw, _millimetres(0.0, PLAUSIBLE_ROUGHNESS_M[1])] | None = None
    correlation_length_mm: Annotated[Draw, _millimetres(*PLAUSIBLE_CORRELATION_M)] | None = None
    coating_thickness_mm: Annotated[Draw, _millimetres(*PLAUSIBLE_COATING_M)] | None = None

    @model_validator(mode="after")
    def _check(self) -> PartMaterial:
        if self.coating_thickness_mm is not None and self.of.coating is None:
            got = repr(self.of.name)
            raise mistake("a material with a coating", got, key="coating_thickness_mm")
        tried(lambda: (self.least, self.drawn({n: d.bounds()[1] for n, d in self.draws.items()})))
        return self

    @property
    def draws(self) -> dict[str, Draw]:
        """What is drawn, by its key in a plan."""
        return {name: draw for name in LENGTHS if (draw := getattr(self, name)) is not None}

    def drawn(self, lengths_mm: Mapping[str, float]) -> Material:
        """Return the material with these lengths in place of its own."""
        values: dict[str, Any] = {
            name.replace("_mm", "_m"): length_mm / 1e3 for name, length_mm in lengths_mm.items()
        }
        thickness_m = values.pop("coating_thickness_m", None)
        if thickness_m is not None and self.of.coating is not None:
            values["coating"] = replace(self.of.coating, thickness_m=thickness_m)
        return replace(self.of, **values)

    @property
    def least(self) -> Material:
        """The material of the least lengths, which are those of a sample where nothing is drawn."""
        return self.drawn({name: draw.bounds()[0] for name, draw in self.draws.items()})


def _part(value: Any, info: ValidationInfo) -> Any:
    """A material by itself is one whose lengths are its own."""
    if isinstance(value, dict | PartMaterial):
        return value
    return PartMaterial(of=_made_of(value, info))


Part = Annotated[PartMaterial, BeforeValidator(_part)]


class PlanMaterials(FileRecord):
    """What a hand is made of, by part; `others` is one value for all parts without their own."""

    palm: Part | None = None
    thumb: Part | None = None
    index: Part | None = None
    middle: Part | None = None
    ring: Part | None = None
    pinky: Part | None = None
    others: Part = PartMaterial()

    @property
    def of_parts(self) -> Mapping[str, Material]:
        """The material of every part of a sample, of which nothing is to be drawn."""
        return {name: (getattr(self, name) or self.others).least for name in PART_NAMES}


def _of_all(value: Any, info: ValidationInfo) -> Any:
    if isinstance(value, dict) and (not value or {*PART_NAMES, "others"} & set(value)):
        return value
    if isinstance(value, dict | PlanMaterials):
        return value if isinstance(value, PlanMaterials) else {"others": value}
    return PlanMaterials(others=PartMaterial(of=_made_of(value, info)))


MaterialsOfParts = Annotated[PlanMaterials, BeforeValidator(_of_all)]

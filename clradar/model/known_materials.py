"""Materials by name, each with the source of its values."""

from __future__ import annotations

from clradar.model import checks
from clradar.model.material import METAL, Coating, Material
from clradar.model.permittivity import ColeCole

DRY_SKIN = ColeCole(4.0, ((32.0, 7.234e-12), (1100.0, 32.48e-9, 0.2)), 2e-4)

KNOWN = {
    known.name: known
    for known in (
        METAL,
        Material("skin", DRY_SKIN, roughness_rms_m=0.05e-3, correlation_length_m=1e-3),
        Material(
            "palm",
            DRY_SKIN,
            coating=Coating(140e-6, 3.1 - 0.4j),
            roughness_rms_m=0.15e-3,
            correlation_length_m=3e-3,
        ),
        Material("plaster", 2.94 - 0.06j, roughness_rms_m=0.1e-3, correlation_length_m=2e-3),
    )
}


def material(name: str) -> Material:
    """Return a known material, such as "skin", "palm" or "metal"; docs/materials.md lists them.

    Raises
    ------
    ModelError
        No material has that name.

    Examples
    --------
    >>> import clradar
    >>> clradar.material("palm").coating.thickness_m
    0.00014
    """
    return KNOWN[checks.one_of("material", name, tuple(KNOWN))]

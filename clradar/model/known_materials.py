"""Materials by name, each with the source of its values; docs/materials.md discusses them."""

from __future__ import annotations

from clradar.model import checks
from clradar.model.material import METAL, Coating, Material
from clradar.model.permittivity import ColeCole, PowerLaw

_GABRIEL = "S. Gabriel et al., Phys. Med. Biol. 41 (1996) 2271"
_ITU = "Rec. ITU-R P.2040-2 (2021), table 3, 1 to 100 GHz"
_ZHEKOV = "S. S. Zhekov et al., doi 10.1109/MAP.2019.2955680, their Cole-Cole fit at 77 GHz"
_SMOOTH = "smooth: assumption"

DRY_SKIN = ColeCole(4.0, ((32.0, 7.234e-12), (1100.0, 32.481e-9, 0.2)), 2e-4)
WET_SKIN = ColeCole(
    4.0,
    ((39.0, 7.958e-12, 0.1), (280.0, 79.577e-9), (3e4, 1.592e-6, 0.16), (3e4, 1.592e-3, 0.2)),
    4e-4,
)
HORNY_LAYER = ColeCole(2.96, ((1.5, 6.9e-12),))

_ALL = (
    METAL,
    Material(
        "skin",
        DRY_SKIN,
        roughness_rms_m=0.05e-3,
        correlation_length_m=1e-3,
        source=f"{_GABRIEL}, dry skin; roughness: inferred",
    ),
    Material(
        "skin-wet",
        WET_SKIN,
        roughness_rms_m=0.05e-3,
        correlation_length_m=1e-3,
        source=f"{_GABRIEL}, wet skin; roughness: inferred",
    ),
    Material(
        "palm",
        DRY_SKIN,
        coating=Coating(140e-6, HORNY_LAYER),
        roughness_rms_m=0.15e-3,
        correlation_length_m=3e-3,
        source=f"{_GABRIEL}, dry skin; thickness of the horny layer: A. Christ et al., "
        "Bioelectromagnetics 42 (2021); its permittivity: S. I. Alekseev, M. C. Ziskin, "
        "Bioelectromagnetics 28 (2007) 331; roughness: inferred",
    ),
    Material(
        "plaster",
        PowerLaw(2.73, 0.0, 0.0085, 0.9395),
        roughness_rms_m=0.1e-3,
        correlation_length_m=2e-3,
        source=f"{_ITU}, plasterboard; roughness: assumption",
    ),
    Material(
        "wood", PowerLaw(1.99, 0.0, 0.0047, 1.0718), source=f"{_ITU}, wood; {_SMOOTH} (planed)"
    ),
    Material(
        "concrete",
        PowerLaw(5.24, 0.0, 0.0462, 0.7822),
        source=f"{_ITU}, concrete; {_SMOOTH} (cast against a smooth face)",
    ),
    Material("glass", PowerLaw(6.31, 0.0, 0.0036, 1.3394), source=f"{_ITU}, glass; {_SMOOTH}"),
    Material(
        "styrodur",
        1.03,
        source="computed: Looyenga's mixture of air with 3 % polystyrene; loss neglected; "
        f"{_SMOOTH}",
    ),
    Material(
        "ptfe",
        2.05 - 0.001j,
        source=f"A. Elhawil et al., IEEE/LEOS Benelux (2007), 70 to 110 GHz; {_SMOOTH}",
    ),
    Material("pmma", 2.56 - 0.019j, source=f"{_ZHEKOV}; {_SMOOTH}"),
    Material("polypropylene", 2.19 - 0.0074j, source=f"{_ZHEKOV}; {_SMOOTH}"),
    Material(
        "polystyrene",
        2.505 - 0.0006j,
        source=f"Z. Abbas et al., 26 to 40 GHz, taken for constant above; {_SMOOTH}",
    ),
    Material(
        "abs",
        2.7 - 0.022j,
        source="B. Riddle et al., IEEE Trans. MTT 51 (2003) 727, 11 GHz, taken for constant above; "
        f"{_SMOOTH}",
    ),
)

KNOWN = {known.name: known for known in _ALL}


def material(name: str) -> Material:
    """Return a known material, such as "skin", "palm" or "metal"; docs/materials.md lists them.

    Examples
    --------
    >>> palm = clradar.material("palm")
    >>> palm.coating.thickness_m, palm.roughness_rms_m
    (0.00014, 0.00015)
    """
    return KNOWN[checks.one_of("material", name, tuple(KNOWN))]

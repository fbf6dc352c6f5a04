"""``clradar materials``: list materials, and what they reflect over the band."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

import clradar as cl
from clradar.cli.console import print_line, print_table, print_text
from clradar.cli.options.common import JSON
from clradar.cli.options.groups import argument, option, wrong_usage
from clradar.cli.parse import check_unit, numbers
from clradar.constants import PLAUSIBLE_HZ

ROUGHNESS = ("roughness_rms", "correlation_length", "micro_roughness_rms")

FREQUENCIES = 101
"""Of the band, at which the reflectance is looked for its extremes."""


def command(
    files: list[Path] = argument(
        "Materials of your own, in place of those that come along.", (), metavar="FILE.toml"
    ),
    band_ghz: str = option("Band of the reflectance.", "72:82", metavar="FIRST:LAST"),
    as_json: bool = JSON,
) -> None:
    """Permittivity and phase are at the middle of the band; the reflected power, least and most
    over the band, is relative to metal, and so is the phase. h is the RMS height and l the
    correlation length of the roughness, h_micro the RMS height of what is finer.
    docs/materials.md describes the files, and discusses the sources.
    """
    from clradar.files.json_text import indented
    from clradar.model.known_materials import KNOWN
    from clradar.model.material_file import read_materials

    first_hz, last_hz = _band(band_ghz)
    frequencies_hz = np.linspace(first_hz, last_hz, FREQUENCIES)
    found = [own for file in files for own in read_materials(file).values()]
    records = [_figures(own, frequencies_hz) for own in found or KNOWN.values()]
    if as_json:
        print_text(indented(records))
        return
    columns = ("name", "permittivity", "coat mm", "power dB", "phase", "h mm", "l mm",
               "h_micro mm")  # fmt: skip
    rows = [_row(record) for record in records]
    shown = len(columns) if any(row[-1] for row in rows) else len(columns) - 1
    print_table(columns[:shown], [row[:shown] for row in rows], right=columns[2:])
    print_line(f"at normal incidence, {band_ghz} GHz, phase in degrees; sources:")
    for own in (record["material"] for record in records):
        print_line(f"{own['name']}: {own.get('source', 'not stated')}")


def _band(text: str) -> tuple[float, float]:
    """The ends of the band in hertz."""
    ends = numbers(text, ":")
    if len(ends) != 2 or ends[1] < ends[0]:
        raise wrong_usage("--band-ghz", f"expected FIRST:LAST with FIRST <= LAST, got '{text}'")
    for end in ends:
        check_unit("--band-ghz", "a frequency", end, PLAUSIBLE_HZ, "GHz")
    return 1e9 * ends[0], 1e9 * ends[1]


def _figures(material: cl.Material, frequencies_hz: np.ndarray) -> dict[str, Any]:
    """The record of a material with its reflectance: values of JSON, metres and hertz."""
    from clradar.model.material_file import material_record

    gamma = material.reflection(frequencies_hz, 1.0)[:, 0]
    middle, powers = len(gamma) // 2, np.abs(gamma) ** 2
    eps = None if material.conductor else complex(material.permittivity_at(frequencies_hz)[middle])
    ends = (powers.min(), powers.max())
    return {
        "material": material_record(material),
        "band_hz": [float(frequencies_hz[0]), float(frequencies_hz[-1])],
        "permittivity_at_middle": None if eps is None else [eps.real, eps.imag],
        "reflectance_db": [10 * math.log10(p) + 0.0 if p > 0 else None for p in ends],
        "phase_deg": math.degrees(np.angle(-gamma[middle])),
    }


def _row(record: dict[str, Any]) -> tuple[str, ...]:
    own, eps = record["material"], record["permittivity_at_middle"]
    low, high = ("-inf" if db is None else f"{db:.1f}" for db in record["reflectance_db"])
    coating_m = own.get("coating", {}).get("thickness_m")
    lengths_m = (coating_m, *(own.get(f"{name}_m") for name in ROUGHNESS))
    coating, *roughness = ("" if m is None else f"{1e3 * m:g}" for m in lengths_m)
    return (
        own["name"],
        "conductor" if eps is None else f"{eps[0]:.2f} - {abs(eps[1]):.3g}j",
        coating,
        low if low == high else f"{low} .. {high}",
        f"{round(record['phase_deg'], 1) + 0.0:.1f}",
        *roughness,
    )

"""``clradar materials``: list materials, and what they reflect over the band."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

import clradar as cl
from clradar.cli import options as opt, parse
from clradar.cli.console import print_line, print_table, print_text

COLUMNS = ("name", "permittivity", "coat mm", "power dB", "phase", "h mm", "l mm", "h_micro mm")
ROUGHNESS = ("roughness_rms", "correlation_length", "micro_roughness_rms")

FREQUENCIES = 101
"""Of the band, at which the reflectance is looked for its extremes."""


def command(
    files: list[Path] = opt.argument(
        "Materials of your own, in place of those that come along.", (), metavar="FILE.toml"
    ),
    band_ghz: tuple[float, float] = opt.option(
        "Band of the reflectance.", "72:82", metavar="FIRST:LAST", parse=parse.ends_ghz
    ),
    as_json: bool = opt.JSON,
) -> None:
    """Permittivity and phase are at the middle of the band; power (least and most over the band)
    and phase are relative to metal. h is the RMS height and l the correlation length of the
    roughness, h_micro the RMS height of what is finer. Files and sources: docs/materials.md.
    """
    from clradar.files.json_text import indented
    from clradar.model.known_materials import KNOWN
    from clradar.model.material_file import read_materials

    first_ghz, last_ghz = band_ghz
    frequencies_hz = np.linspace(1e9 * first_ghz, 1e9 * last_ghz, FREQUENCIES)
    found = [own for file in files for own in read_materials(file).values()]
    records = [_figures(own, frequencies_hz) for own in found or KNOWN.values()]
    if as_json:
        print_text(indented(records))
        return
    rows = [_row(record) for record in records]
    shown = len(COLUMNS) if any(row[-1] for row in rows) else len(COLUMNS) - 1
    print_table(COLUMNS[:shown], [row[:shown] for row in rows], right=COLUMNS[2:])
    band = f"{first_ghz:g} to {last_ghz:g} GHz"
    print_line(f"at normal incidence, {band}, phase in degrees; sources:")
    for own in (record["material"] for record in records):
        print_line(f"{own['name']}: {own.get('source', 'not stated')}")


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
        "phase_deg": math.degrees(np.angle(-gamma[middle])) + 0.0,
    }


def _row(record: dict[str, Any]) -> tuple[str, ...]:
    own, eps = record["material"], record["permittivity_at_middle"]
    low, high = ("-inf" if db is None else f"{db:.1f}" for db in record["reflectance_db"])
    coating_m = own.get("coating", {}).get("thickness_m")
    lengths_m = (coating_m, *(own.get(f"{name}_m") for name in ROUGHNESS))
    coating, *roughness = ("" if m is None else f"{1e3 * m:g}" for m in lengths_m)
    return (
        own["name"], "conductor" if eps is None else f"{eps[0]:.2f} - {abs(eps[1]):.3g}j", coating,
        low if low == high else f"{low} .. {high}", f"{round(record['phase_deg'], 1) + 0.0:.1f}",
        *roughness,
    )  # fmt: skip

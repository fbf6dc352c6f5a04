"""What there is, in tables: ``devices``, ``materials``, ``array``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import typer

import clradar as cl
from clradar.cli import console, options as opt, outputs as out, parse
from clradar.errors import DeviceError
from clradar.files.json_file import indented
from clradar.model.known_materials import KNOWN
from clradar.model.record import plain
from clradar.opencl.choice import fault, select_devices
from clradar.opencl.device import INSTALL_HINT, list_devices

DEVICE_COLUMNS = ("", "selector", "name", "platform", "kind", "memory", "units", "works")


def devices_command() -> None:
    """An asterisk marks what a command would use; --device or the environment variable
    CLRADAR_DEVICE choose another, by its selector or part of its name. Every device is tested: does
    it build kernels and compute as it must?
    """
    devices, chosen, failure = list_devices(), [], None
    try:
        chosen = select_devices(None)
    except DeviceError as error:  # printed after the table, which helps to find the cause
        failure = error
    faults = {info.selector: fault(info.selector) for info in devices}
    rows = [
        (
            "*" if info in chosen else "", info.selector, info.name, info.platform, info.kind,
            f"{info.memory_bytes / 2**30:.1f} GiB", str(info.compute_units),
            "no" if faults[info.selector] else "yes",
        )
        for info in devices
    ]  # fmt: skip
    console.table(DEVICE_COLUMNS, rows, right=("memory", "units"))
    for info in devices:
        text = faults[info.selector]
        if text is None and info.target:
            text = (
                f"this PoCL does not know the processor; it compiles for {info.target} "
                "(docs/install.md)"
            )
        if text is not None:
            console.line(f"{info.selector} {info.label}: {text}")
    if failure is not None:
        raise failure
    for info in chosen:
        if faults[info.selector]:
            raise DeviceError(
                f"a device that would be used, {info.selector} {info.label}, does not work; choose "
                f"another with CLRADAR_DEVICE=..., or {INSTALL_HINT}"
            )
    console.line(f"used: {', '.join(f'{info.selector} {info.label}' for info in chosen)}")


COLUMNS = ("name", "permittivity", "coat mm", "power dB", "phase", "h mm", "l mm", "h_micro mm")
ROUGHNESS = ("roughness_rms", "correlation_length", "micro_roughness_rms")

FREQUENCIES = 101  # of the band, at which the reflectance is looked for its extremes


def materials_command(
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
    first_ghz, last_ghz = band_ghz
    frequencies_hz = np.linspace(1e9 * first_ghz, 1e9 * last_ghz, FREQUENCIES)
    found = [own for file in files for own in cl.read_materials(file).values()]
    records = [_figures(own, frequencies_hz) for own in found or KNOWN.values()]
    if as_json:
        console.text(indented(records))
        return
    rows = [_row(record) for record in records]
    shown = len(COLUMNS) if any(row[-1] for row in rows) else len(COLUMNS) - 1
    console.table(COLUMNS[:shown], [row[:shown] for row in rows], right=COLUMNS[2:])
    band = f"{first_ghz:g} to {last_ghz:g} GHz"
    console.line(f"at normal incidence, {band}, phase in degrees; sources:")
    for own in (record["material"] for record in records):
        console.line(f"{own['name']}: {own.get('source', 'not stated')}")


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


@dataclass(frozen=True, kw_only=True)
class ArrayOptions(opt.RadarOptions):
    array: str = opt.array_option(kind=typer.Argument)


LOBE_COLUMNS = ("lobe", "azimuth (°)", "elevation (°)", "level (dB)", "")
FOCUS_MM = parse.so_many(3, "X,Y,Z in millimetres", plausible=("a coordinate", (0.0, 100.0), "mm"))


def array_command(
    radar: ArrayOptions,
    *,
    output: Path | None = opt.figure("Figure", "-o", "--output"),
    at_mm: tuple[float, ...] = opt.option(
        "Point that the array is focused on.", "0,0,300", metavar="X,Y,Z", parse=FOCUS_MM
    ),
    as_json: bool = opt.JSON,
) -> None:
    """Widths are those of the response at -3 dB, without a window. A lobe is another direction
    whose echoes appear at the focus, too. Clusters are taken together. See docs/arrays.md.
    """
    from clradar.arrays.lobes import LEVEL_DB

    clusters, waveform = radar.clusters(), radar.waveform()
    name = clusters[0].name.partition(", cluster ")[0]
    with console.bar("searching lobes"):
        found = cl.arrays.array_figures(clusters, waveform, opt.scaled(at_mm, 1e3))
    first_ghz, last_ghz, _ = radar.band
    at = ",".join(f"{v:g}" for v in at_mm)
    title = f"{name}, {first_ghz:g} to {last_ghz:g} GHz, focused on {at} mm"
    figure = partial(cl.plot.array_figure, clusters, waveform, found, title)
    out.write(output, figure, "" if as_json else "elements, virtual aperture, response")
    if as_json:
        keys = ("focus_m", "widths_m", "range_cell_m", "unambiguous_range_m", "within_deg")
        record = plain({key: getattr(found, key) for key in (*keys, "lobes")})
        console.text(indented({"array": name, "clusters": len(clusters), **record}))
        return
    widths = ", ".join(f"{a} {_mm(w)}" for a, w in zip("xyz", found.widths_m, strict=True))
    several = f"{len(clusters)} clusters of " if len(clusters) > 1 else ""
    antennas = f"{several}{clusters[0].n_tx} Tx, {clusters[0].n_rx} Rx"
    console.line(f"{name}: {antennas}, focused on {at.replace(',', ', ')} mm")
    console.line(f"widths at -3 dB: {widths}; resolution in range c/2B {_mm(found.range_cell_m)}")
    console.line(f"unambiguous range c/2df: {_mm(found.unambiguous_range_m)}")
    within = f" within {found.within_deg:g}°" if found.within_deg < 90 else ""
    console.line(("lobes" if found.lobes else f"no other lobe above {LEVEL_DB:g} dB") + within)
    rows = []
    for number, lobe in enumerate(found.lobes, start=1):
        angles = [f"{round(a, 1) + 0.0:.1f}" for a in (lobe.azimuth_deg, lobe.elevation_deg)]
        level, kind = f"{lobe.level_db:.1f}", "grating lobe" if lobe.grating else ""
        rows.append([str(number), *angles, level, kind])
    if rows:
        console.table(LOBE_COLUMNS, rows, right=LOBE_COLUMNS[:4])
    if any(lobe.grating for lobe in found.lobes):
        console.warning(f"{name}: echoes from the directions of grating lobes look like the focus")


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.1f} mm" if length_m < float("inf") else "none"

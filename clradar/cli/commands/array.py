"""``clradar array``: draw an antenna array, and say what it resolves and what it confuses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli.console import print_line, print_table, print_text, print_warning, progress_bar

if TYPE_CHECKING:
    from clradar.arrays import ArrayFigures

COLUMNS = ("azimuth deg", "elevation deg", "dB", "")


@dataclass(frozen=True, kw_only=True)
class ArrayOptions(opt.RadarOptions):
    """The antennas, and the frequencies."""

    array: str = opt.argument(opt.ARRAY_HELP, "qar50", metavar="ARRAY")


def _focus_mm(option: str, text: str) -> tuple[float, ...]:
    place_mm = parse.position_mm(option, text)
    parse.check_unit(option, "a coordinate", max(map(abs, place_mm)), (0.0, 100.0), "mm")
    return place_mm


def command(
    radar: ArrayOptions,
    *,
    output: Path | None = opt.output_option(
        "Figure: .png, .pdf or .svg.", None, "--figure", check=parse.figure
    ),
    at_mm: tuple[float, ...] = opt.option(
        "Point that the array is focused on.", "0,0,300", metavar="X,Y,Z", parse=_focus_mm
    ),
    within_deg: float | None = opt.option("Lobes up to this angle. [default: 90, or less]"),
    as_json: bool = opt.JSON,
    force: bool = opt.FORCE,
) -> None:
    """Widths are those of the response at -3 dB, without a window. A lobe is another direction
    whose echoes appear at the focus, too. Clusters are taken together. See docs/arrays.md.
    """
    from clradar.arrays import array_figures
    from clradar.files.json_text import indented

    clusters, waveform = radar.clusters(), radar.waveform()
    name = clusters[0].name.partition(", cluster ")[0]
    with progress_bar("searching lobes"):
        found = array_figures(clusters, waveform, parse.metres(at_mm), within_deg=within_deg)
    if as_json:
        print_text(indented({"array": name, "clusters": len(clusters), **record_of(found)}))
    else:
        print_figures(name, clusters, found)
    if output is not None:
        from clradar.plot import array_figure, save_figure

        first_ghz, last_ghz, _ = radar.band
        at = ",".join(f"{v:g}" for v in at_mm)
        title = f"{name}, {first_ghz:g} to {last_ghz:g} GHz, focused on {at} mm"
        with progress_bar("drawing"):
            save_figure(array_figure(clusters, waveform, found, title), output, force=force)
        if not as_json:
            print_line(f"{output}: elements, virtual aperture, response")


def print_figures(name: str, clusters: Sequence[cl.AntennaArray], found: ArrayFigures) -> None:
    """Print widths, ranges and lobes."""
    from clradar.arrays.figures_of_merit import LEVEL_DB

    at = ", ".join(f"{1e3 * value:g}" for value in found.focus_m)
    widths = ", ".join(f"{a} {_mm(w)}" for a, w in zip("xyz", found.widths_m, strict=True))
    several = f"{len(clusters)} clusters of " if len(clusters) > 1 else ""
    antennas = f"{several}{clusters[0].n_tx} Tx, {clusters[0].n_rx} Rx"
    print_line(f"{name}: {antennas}, focused on {at} mm")
    print_line(f"widths at -3 dB: {widths}; resolution in range c/2B {_mm(found.range_cell_m)}")
    print_line(f"unambiguous range c/2df: {_mm(found.unambiguous_range_m)}")
    within = f" within {found.within_deg:g} degrees" if found.within_deg < 90 else ""
    print_line(("lobes" if found.lobes else f"no other lobe above {LEVEL_DB:g} dB") + within)
    rows = []
    for lobe in found.lobes:
        angles = [f"{round(a, 1) + 0.0:.1f}" for a in (lobe.azimuth_deg, lobe.elevation_deg)]
        rows.append([*angles, f"{lobe.level_db:.1f}", "grating lobe" if lobe.grating else ""])
    if rows:
        print_table(COLUMNS, rows, right=COLUMNS[:3])
    if any(lobe.grating for lobe in found.lobes):
        print_warning(f"{name}: echoes from the directions of grating lobes look like the focus")


def record_of(found: ArrayFigures) -> dict[str, Any]:
    """The figures in types of JSON; None where a length is endless."""
    names = ("focus_m", "widths_m", "range_cell_m", "unambiguous_range_m", "within_deg")
    record = {name: np.asarray(getattr(found, name)).tolist() for name in names}
    record["widths_m"] = [width if width < np.inf else None for width in record["widths_m"]]
    record |= {k: None for k, value in record.items() if value == np.inf}
    lobes = (asdict(lobe).items() for lobe in found.lobes)
    return {**record, "lobes": [{k: np.asarray(v).tolist() for k, v in one} for one in lobes]}


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.1f} mm" if length_m < float("inf") else "none"

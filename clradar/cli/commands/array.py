"""``clradar array``: draw an antenna array, and say what it resolves and what it confuses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.console import print_line, print_table, print_text, print_warning, progress_bar
from clradar.cli.options.common import FORCE, JSON
from clradar.cli.options.groups import argument, option, output_option
from clradar.cli.options.measured import ARRAY_HELP, BandOptions, RadarOptions
from clradar.cli.outputs import check_figure, check_outputs
from clradar.cli.parse import check_unit, position_m

if TYPE_CHECKING:
    from clradar.arrays import ArrayFigures

FARTHEST_M = 100.0


def command(
    array: str = argument("qar50", ARRAY_HELP, metavar="ARRAY"),
    *,
    output: Path | None = output_option(None, "Figure: .png, .pdf or .svg."),
    at_mm: str = option("0,0,300", "Point that the array is focused on.", metavar="X,Y,Z"),
    band: BandOptions,
    within_deg: float | None = option(
        None,
        "Lobes in directions up to this angle to boresight. [default: 90, less where the search "
        "would take minutes]",
        metavar="DEG",
    ),
    as_json: bool = JSON,
    force: bool = FORCE,
) -> None:
    """Widths are those of the response at -3 dB, which back-projection has without a window. A lobe
    is another direction whose echoes appear at the focus, too, with its level over the whole band.
    Clusters whose Tx are measured with their own Rx only are taken together, as one image of all of
    them is. See docs/arrays.md.
    """
    from clradar.arrays import array_figures
    from clradar.files.json_text import indented

    check_figure(output)
    radar = RadarOptions(array=array, band=band.band)
    check_outputs([output], force=force, inputs=radar.files)
    focus_m, clusters, waveform = position_m("--at-mm", at_mm), radar.clusters(), radar.waveform()
    farthest_mm = 1e3 * max(map(abs, focus_m))
    check_unit("--at-mm", "a coordinate", farthest_mm, (0.0, FARTHEST_M), "mm")
    name = clusters[0].name.partition(", cluster ")[0]
    with progress_bar("searching lobes"):
        found = array_figures(clusters, waveform, focus_m, within_deg=within_deg)
    if output is not None:
        from clradar.plot import array_figure, save_figure

        title = (
            f"{name}, {waveform.frequencies_hz[0] / 1e9:g} to "
            f"{waveform.frequencies_hz[-1] / 1e9:g} GHz, focused on {at_mm} mm"
        )
        with progress_bar("drawing"):
            save_figure(array_figure(clusters, waveform, found, title), output, force=force)
    if as_json:
        print_text(indented({"array": name, "clusters": len(clusters), **_record(found)}))
    else:
        _print_figures(name, clusters, found)
        if output is not None:
            print_line(f"{output}: elements, virtual aperture, response")


def _print_figures(name: str, clusters: Sequence[cl.AntennaArray], found: ArrayFigures) -> None:
    from clradar.arrays.figures_of_merit import LEVEL_DB

    at = ", ".join(f"{1e3 * value:g}" for value in found.focus_m)
    widths = ", ".join(f"{a} {_mm(w)}" for a, w in zip("xyz", found.widths_m, strict=True))
    antennas = f"{clusters[0].n_tx} Tx, {clusters[0].n_rx} Rx"
    if len(clusters) > 1:
        antennas = f"one image of {len(clusters)} clusters of {antennas} each"
    print_line(f"{name}: {antennas}, focused on {at} mm")
    print_line(f"widths at -3 dB: {widths}; resolution in range c/2B {_mm(found.range_cell_m)}")
    print_line(f"unambiguous range c/2df: {_mm(found.unambiguous_range_m)}")
    within = f" within {found.within_deg:g} degrees" if found.within_deg < 90 else ""
    if not found.lobes:
        print_line(f"no other lobe above {LEVEL_DB:g} dB{within}")
        return
    if within:
        print_line(f"lobes{within}:")
    rows = []
    for lobe in found.lobes:
        angles = [f"{round(a, 1) + 0.0:.1f}" for a in (lobe.azimuth_deg, lobe.elevation_deg)]
        rows.append([*angles, f"{lobe.level_db:.1f}", "grating lobe" if lobe.grating else ""])
    columns = ("azimuth deg", "elevation deg", "dB", "")
    print_table(columns, rows, right=columns[:3])
    if any(lobe.grating for lobe in found.lobes):
        print_warning(
            f"{name}: echoes from the directions of grating lobes look like the focus; keep them "
            "empty, use antennas that do not see them, or space the antennas more closely"
        )


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.1f} mm" if length_m < float("inf") else "none"


def _record(value: Any) -> Any:
    """Fields and numbers in types of JSON; None where a length is endless."""
    if is_dataclass(value):
        names = [one.name for one in fields(value) if one.name != "over_directions"]
        return {name: _record(getattr(value, name)) for name in names}
    if isinstance(value, tuple | np.ndarray):
        return [_record(item) for item in value]
    return None if value == float("inf") else value

"""``clradar array``: draw an antenna array, and say what it resolves and what it confuses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from clradar.cli import options as opt, parse, tables
from clradar.cli.console import print_text, progress_bar
from clradar.cli.outputs import write

if TYPE_CHECKING:
    from clradar.arrays import ArrayFigures


@dataclass(frozen=True, kw_only=True)
class ArrayOptions(opt.RadarOptions):
    """The antennas, and the frequencies."""

    array: str = opt.array_option(kind=typer.Argument)


FOCUS_MM = parse.so_many(3, "X,Y,Z in millimetres", plausible=("a coordinate", (0.0, 100.0), "mm"))


def command(
    radar: ArrayOptions,
    *,
    output: Path | None = opt.output_option(
        "Figure: .png, .pdf or .svg.", None, "--figure", check=parse.figure
    ),
    at_mm: tuple[float, ...] = opt.option(
        "Point that the array is focused on.", "0,0,300", metavar="X,Y,Z", parse=FOCUS_MM
    ),
    within_deg: float | None = opt.option("Lobes up to this angle. [default: 90, or less]"),
    as_json: bool = opt.JSON,
) -> None:
    """Widths are those of the response at -3 dB, without a window. A lobe is another direction
    whose echoes appear at the focus, too. Clusters are taken together. See docs/arrays.md.
    """
    from clradar.arrays import array_figures
    from clradar.files.json_text import indented
    from clradar.plot import array_figure

    clusters, waveform = radar.clusters(), radar.waveform()
    name = clusters[0].name.partition(", cluster ")[0]
    with progress_bar("searching lobes"):
        found = array_figures(clusters, waveform, opt.scaled(at_mm, 1e3), within_deg=within_deg)
    first_ghz, last_ghz, _ = radar.band
    at = ",".join(f"{v:g}" for v in at_mm)
    title = f"{name}, {first_ghz:g} to {last_ghz:g} GHz, focused on {at} mm"
    figure = partial(array_figure, clusters, waveform, found, title)
    write(output, figure, "" if as_json else "elements, virtual aperture, response")
    if as_json:
        print_text(indented({"array": name, "clusters": len(clusters), **record_of(found)}))
    else:
        tables.print_array(name, clusters, found)


def record_of(found: ArrayFigures) -> dict[str, Any]:
    """The figures in types of JSON; None where a length is endless."""
    names = ("focus_m", "widths_m", "range_cell_m", "unambiguous_range_m", "within_deg")
    record = {name: np.asarray(getattr(found, name)).tolist() for name in names}
    record["widths_m"] = [width if width < np.inf else None for width in record["widths_m"]]
    record |= {k: None for k, value in record.items() if value == np.inf}
    lobes = (asdict(lobe).items() for lobe in found.lobes)
    return {**record, "lobes": [{k: np.asarray(v).tolist() for k, v in one} for one in lobes]}

"""Estimate alpha by a sweep: a script to run, copy and edit.

    python calibration/scripts/align.py capture.h5 hand.ply -o transform.json
    python calibration/scripts/sweep.py capture.h5 hand.ply --transform transform.json -o sweep.png

`clradar sweep` does the same with more options, resumes after an interruption, and estimates an
alpha per region; docs/sweep.md explains the result.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import clradar
from calibration import sweep
from calibration.roughness.figures import sweep_figure
from calibration.scripts.scripting import Force, Recorded, Unit, refuse_existing, run
from clradar.plot import save_figure
from measurement_io import open_capture, read_transform

# Where the object is: x, y and z in metres, 2 mm voxels. Half a resolution cell is enough here.
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 2e-3)


def main(
    capture: Recorded,
    mesh: Annotated[Path, typer.Argument(help="Mesh of the object.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Figure: .png, .pdf or .svg.")],
    transform: Annotated[
        Path | None,
        typer.Option(help="JSON file of align.py; without it the mesh is in its place."),
    ] = None,
    unit: Unit = "m",
    step: Annotated[float, typer.Option(help="Of alpha, from 0 to 1.")] = 0.1,
    seeds: Annotated[int, typer.Option(help="Simulations for each alpha.")] = 3,
    samples_per_mm2: Annotated[float, typer.Option(help="Of the mesh's surface.")] = 10.0,
    force: Force = False,
) -> None:
    """Simulate MESH at alphas from 0 to 1 and compare each image with CAPTURE."""
    refuse_existing(output, force=force)
    if not 0 < step <= 1:
        raise typer.BadParameter("expected a number in (0, 1]", param_hint="--step")
    measured = open_capture(capture)
    place = None if transform is None else read_transform(transform)
    scene = clradar.Scene.from_mesh(mesh, unit=unit, transform=place)
    found = sweep(
        clradar.backproject(measured, GRID),
        scene,
        np.minimum(np.arange(0.0, 1.0 + step / 2, step), 1.0),
        seeds=seeds,
        array=measured.array,
        waveform=measured.waveform,
        samples_per_mm2=samples_per_mm2,
    )
    print(found.report())
    save_figure(sweep_figure(found), output, force=force)


if __name__ == "__main__":
    run(main)

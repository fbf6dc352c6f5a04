"""Estimate alpha by a sweep: a script to run, copy and edit.

    python calibration/scripts/align.py capture.h5 hand.ply -o transform.json
    python calibration/scripts/sweep.py capture.h5 hand.ply --transform transform.json -o sweep.png

`clradar sweep` does the same with more options, resumes after an interruption, and estimates an
alpha per region; docs/sweep.md explains the result.
"""

from pathlib import Path

import numpy as np

import clradar
from calibration import sweep
from calibration.roughness.figures import sweep_figure
from calibration.scripts.scripting import GRID, Mesh, Output, Recorded, Unit, run
from clradar.plot import save_figure
from measurement_io import open_capture, read_transform


def main(
    capture: Recorded,
    mesh: Mesh,
    output: Output,
    transform: Path | None = None,
    unit: Unit = "m",
    alphas: int = 11,
    seeds: int = 3,
    samples_per_mm2: float = 10.0,
) -> None:
    """Simulate MESH at so many alphas from 0 to 1 and compare each image with CAPTURE.

    TRANSFORM is the file of align.py; without it the mesh is in its place.
    """
    measured = open_capture(capture)
    place = None if transform is None else read_transform(transform)
    found = sweep(
        clradar.backproject(measured, GRID),
        clradar.Scene.from_mesh(mesh, unit=unit, transform=place),
        np.linspace(0.0, 1.0, alphas), seeds=seeds, samples_per_mm2=samples_per_mm2,
        array=measured.array, waveform=measured.waveform,
    )  # fmt: skip
    print(found.report())
    save_figure(sweep_figure(found), output)


if __name__ == "__main__":
    run(main)

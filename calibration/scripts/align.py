"""Find where a mesh stood when it was measured: a script to run, copy and edit.

    python calibration/scripts/align.py capture.h5 hand.ply -o transform.json

`clradar align` does the same with more options; docs/calibration.md explains the result.
"""

import json
from pathlib import Path
from typing import Annotated

import typer

import clradar
from calibration import align_mesh
from calibration.scripts.scripting import run, write_text
from clradar.files.atomic import refuse_existing
from measurement_io import open_capture

# Where the object is: x, y and z in metres, 2 mm voxels. Half a resolution cell is enough here.
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 2e-3)


def main(
    capture: Annotated[Path, typer.Argument(help="Recorded or simulated capture.")],
    mesh: Annotated[Path, typer.Argument(help="Mesh of the object, placed anywhere.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="JSON file with the transform.")],
    unit: Annotated[str, typer.Option(help="Unit of the mesh file: m, cm or mm.")] = "m",
    quick: Annotated[bool, typer.Option(help="Do not correct the bias by simulating.")] = False,
    force: Annotated[bool, typer.Option(help="Replace an existing file.")] = False,
) -> None:
    """Find the rigid motion that brings MESH onto what the radar measured of it."""
    refuse_existing(output, force=force)
    measured = open_capture(capture)
    scene = clradar.Scene.from_mesh(mesh, unit=unit)
    found = align_mesh(
        clradar.backproject(measured, GRID),
        scene,
        correct_bias=not quick,
        array=measured.array,
        waveform=measured.waveform,
    )
    print(found.report())
    write_text(output, json.dumps(found.to_dict(), indent=1) + "\n", force=force)


if __name__ == "__main__":
    run(main)

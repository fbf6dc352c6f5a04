"""Register a mesh to a measurement: a script to run, copy and edit.

    python calibration/scripts/align.py capture.h5 hand.ply -o transform.json

`clradar align` does the same with more options; docs/calibration.md explains the result.
"""

from pathlib import Path
from typing import Annotated

import typer

import clradar
from calibration import align_mesh
from calibration.scripts.scripting import Force, Recorded, Unit, refuse_existing, run, write_json
from measurement_io import open_capture

# Where the object is: x, y and z in metres, 2 mm voxels. Half a resolution cell is enough here.
GRID = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 2e-3)


def main(
    capture: Recorded,
    mesh: Annotated[Path, typer.Argument(help="Mesh of the object, placed anywhere.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="JSON file with the transform.")],
    unit: Unit = "m",
    quick: Annotated[bool, typer.Option(help="Do not correct the bias by simulating.")] = False,
    force: Force = False,
) -> None:
    """Find the rigid motion that brings MESH onto its measured image."""
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
    write_json(output, found.to_dict(), force=force)


if __name__ == "__main__":
    run(main)

"""Register a mesh to a measurement: a script to run, copy and edit.

    python calibration/scripts/align.py capture.h5 hand.ply -o transform.json

`clradar align` does the same with more options; docs/calibration.md explains the result.
"""

import clradar
from calibration import align_mesh
from calibration.scripts.scripting import GRID, Mesh, Output, Recorded, Unit, run
from clradar.files.json_file import write_json
from measurement_io import open_capture


def main(
    capture: Recorded, mesh: Mesh, output: Output, unit: Unit = "m", quick: bool = False
) -> None:
    """Find the rigid motion that brings MESH, placed anywhere, onto its measured image.

    With --quick the bias is not corrected by simulations.
    """
    measured = open_capture(capture)
    found = align_mesh(
        clradar.backproject(measured, GRID), clradar.Scene.from_mesh(mesh, unit=unit),
        correct_bias=not quick, array=measured.array, waveform=measured.waveform,
    )  # fmt: skip
    print(found.report())
    write_json(output, found.to_dict(), force=False)


if __name__ == "__main__":
    run(main)

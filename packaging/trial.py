"""What an installed clradar has to do: run by `make release` beside the results of its demo.

The argument is the checkout, from which nothing may be imported.
"""

import sys
from pathlib import Path

import numpy as np

import calibration
import clradar
import measurement_io
from clradar.hand import hand_mesh

checkout = Path(sys.argv[1]).resolve()
for package in (clradar, measurement_io, calibration):
    if checkout in Path(package.__file__).resolve().parents:
        sys.exit(f"expected the installed {package.__name__}, got {package.__file__}")

scene = clradar.Scene.from_mesh(hand_mesh("F"), material="skin")
array = clradar.arrays.qar50()
capture = clradar.simulate(scene, array, clradar.Waveform.sfcw(72e9, 82e9, 32), seed=0)
measurement_io.save_capture("capture.h5", capture)
read = measurement_io.open_capture("capture.h5")
if not np.array_equal(read.data, capture.data):
    sys.exit("expected the capture that was written, got another one")
grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), spacing_m=4e-3)
metrics = clradar.compare(clradar.backproject(read, grid), clradar.backproject(capture, grid))
if metrics.overlap < 0.999:
    sys.exit(f"expected an image like itself, got an overlap of {metrics.overlap}")

made = sorted(path.name for path in Path("demo").iterdir())
if not {"comparison.png", "metrics.json"} <= set(made):
    sys.exit(f"expected figure and metrics of the demo, got {made}")
print(f"clradar {clradar.__version__} on {clradar.open_device().info.label}: demo and trial pass")

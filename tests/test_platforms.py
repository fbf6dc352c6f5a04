"""Other systems, simulated on Linux by taking away what they have not (`other_systems`)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

IMPORT_ALL = """
import sys
from other_systems import become
become(sys.argv[1])
import importlib, pkgutil
from test_doctests import PACKAGES

# Packages for benchmarks or training may be here or not, and are not ours to try.
PEERS = ("numba", "finufft", "mitsuba", "embreex", "torch")
sys.modules.update(dict.fromkeys(PEERS))

def public():
    packages = map(importlib.import_module, PACKAGES)
    return [(p.__name__, name, getattr(p, name)) for p in packages for name in p.__all__]

before, count = public(), 0
for name in ("clradar", "measurement_io", "calibration"):
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, name + "."):
        if not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                assert error.name in PEERS, error.name
            count += 1
print(count > 300, "shadowed:", [new[:2] for old, new in zip(before, public()) if new != old])
"""

USE = """
import os
from pathlib import Path
import numpy as np
import clradar
from clradar.errors import MeasurementError, OutputError
from clradar.jobs import lock as work_folder
from clradar.files.atomic import write_file
from clradar.files.confined import process
from measurement_io import open_capture, save_capture

array = clradar.AntennaArray(np.zeros((1, 3)), np.zeros((1, 3)))
data = np.ones((1, 1, 2), np.complex64)
save_capture("a.h5", clradar.Capture(data, array, clradar.Waveform.sfcw(72e9, 82e9, 2)))
save_capture("a.h5", open_capture("a.h5"), force=True)  # the reader has closed it
assert np.array_equal(open_capture("a.h5").data, data)
assert process._forking._process is None and not process._FORKS  # started, not forked
Path("damaged.h5").write_bytes(Path("a.h5").read_bytes()[:900])
try:
    open_capture("damaged.h5")
except MeasurementError as error:
    print("damaged:", error)

with work_folder.held(Path("work"), "sweep"):
    try:
        with work_folder.held(Path("work"), "sweep"):
            print("held twice")
    except OutputError as error:
        print("locked:", error)
with work_folder.held(Path("work"), "sweep"):
    write_file(Path("work") / "text", b"a\\n")
print(sorted(os.listdir("work")), Path("work/text").read_bytes())

from clradar.jobs.workers import KeepToCores, own_cores
from clradar.files.interrupts import interrupts_blocked
KeepToCores(own_cores()).setup(None)
with interrupts_blocked():
    print("cores:", own_cores() == list(range(os.cpu_count())))
print(clradar.open_device("pocl").info.name != "")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="what other systems lack is taken from Linux")
@pytest.mark.device
@pytest.mark.parametrize("system", ["win32", pytest.param("darwin", marks=pytest.mark.slow)])
def test_modules_files_locks_and_workers(system, tmp_path):
    """And whichever modules were imported, public names stay what they are."""
    paths = (ROOT, ROOT / "tests", ROOT / "tests" / "support")
    done = subprocess.run(
        [sys.executable, "-W", "error::ResourceWarning", "-c", IMPORT_ALL + USE, system],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    imported, damaged, *lines = done.stdout.splitlines()
    assert imported == "True shadowed: []", done.stdout
    assert damaged.startswith("damaged: damaged.h5: expected a readable native HDF5 file"), damaged
    assert lines == [
        "locked: work: another sweep is writing into it",
        "['text'] b'a\\n'",
        "cores: True",
        "True",
    ]

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

# Packages for benchmarks or training may be here or not, and are not ours to try.
PEERS = ("numba", "finufft", "mitsuba", "embreex", "torch")
sys.modules.update(dict.fromkeys(PEERS))
count = 0
for name in ("clradar", "measurement_io", "calibration"):
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, name + "."):
        if not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                assert error.name in PEERS, error.name
            count += 1
print(count > 300)
"""

USE = """
import sys
from other_systems import become
become(sys.argv[1])
import os, subprocess
from pathlib import Path
import numpy as np
import clradar
from clradar.errors import MeasurementError, OutputError
from clradar.files import confined
from clradar.jobs import lock as work_folder
from clradar.files.atomic import write_file
from clradar.files.confined import process
from measurement_io import open_capture, save_capture

array = clradar.AntennaArray(np.zeros((1, 3)), np.zeros((1, 3)))
data = np.ones((1, 1, 2), np.complex64)
save_capture("a.h5", clradar.Capture(data, array, clradar.Waveform.sfcw(72e9, 82e9, 2)))
save_capture("a.h5", open_capture("a.h5"), force=True)  # the reader has closed it
assert np.array_equal(open_capture("a.h5").data, data)
assert process._server is None and not process._FORKS  # a process was started, not forked
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


def output_of(code: str, system: str, folder: Path) -> str:
    paths = (ROOT, ROOT / "tests" / "support")
    done = subprocess.run(
        [sys.executable, "-W", "error::ResourceWarning", "-c", code, system],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="what other systems lack is taken from Linux")
@pytest.mark.parametrize("system", ["win32", pytest.param("darwin", marks=pytest.mark.slow)])
class TestSimulated:
    def test_every_module_can_be_imported(self, system, tmp_path):
        assert output_of(IMPORT_ALL, system, tmp_path) == "True\n"

    @pytest.mark.device
    def test_files_locks_and_workers(self, system, tmp_path):
        lines = output_of(USE, system, tmp_path).splitlines()
        assert lines[0].startswith("damaged: damaged.h5: expected a readable native HDF5 file"), (
            lines
        )
        assert lines[1:] == [
            "locked: work: another sweep is writing into it",
            "['text'] b'a\\n'",
            "cores: True",
            "True",
        ]

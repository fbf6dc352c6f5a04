"""Public names stay what they are, whichever modules were imported before."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
from test_doctests import PACKAGES

PROGRAM = """
import importlib, json, pkgutil, sys, types
sys.path.append("support")
from test_doctests import PACKAGES

def described(item):
    if isinstance(item, types.ModuleType):
        return f"module {item.__name__}"
    where = [getattr(item, name, "") for name in ("__module__", "__name__")]
    return f"{type(item).__name__} {'.'.join(where)}"

def names():
    return {
        f"{name}.{public}": described(getattr(importlib.import_module(name), public))
        for name in PACKAGES for public in importlib.import_module(name).__all__
    }

before = names()
for name in ("clradar", "measurement_io", "calibration"):
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, name + "."):
        if not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:  # an optional package
                if error.name.split(".")[0] in ("clradar", "measurement_io", "calibration"):
                    raise
print(json.dumps([before, names()]))
"""


def test_no_module_shadows_a_public_name():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True,
        cwd=Path(__file__).parent,
    )  # fmt: skip
    names, later = json.loads(done.stdout)
    assert later == names
    modules = {name for name, what in names.items() if what.startswith("module")}
    assert modules == {"clradar.arrays"}
    assert names["calibration.align"] == "function calibration.registration.align_images.align"


@pytest.mark.parametrize("name", [*PACKAGES, "clradar.plot", "clradar.model"])
def test_dir_shows_the_public_names_alone(name):
    package = importlib.import_module(name)
    assert dir(package) == sorted(package.__all__)


def test_the_package_is_imported_when_it_is_used():
    program = """
import sys, clradar
assert not {"numpy", "clradar.model"} & set(sys.modules), sorted(sys.modules)
from clradar import *
assert {"numpy", "pyopencl"} <= set(sys.modules)
assert not {"trimesh", "scipy", "skimage", "matplotlib", "h5py"} & set(sys.modules)
assert backproject is clradar.backproject and open_dataset and __version__
assert not hasattr(clradar, "no_such_name")
"""
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True)

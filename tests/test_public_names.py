"""Public names stay what they are, whichever modules were imported before."""

import importlib
import subprocess
import sys
import types

import pytest
from test_doctests import PACKAGES


def test_only_packages_are_modules():
    """No name is shadowed by its module: `test_platforms` imports all of them."""
    found = {
        f"{name}.{public}": getattr(importlib.import_module(name), public)
        for name in PACKAGES
        for public in importlib.import_module(name).__all__
    }
    modules = {name for name, item in found.items() if isinstance(item, types.ModuleType)}
    packages = {name for name in PACKAGES if name.startswith("clradar.")}
    assert modules == packages | {"clradar.model", "clradar.plot"}
    assert found["calibration.align"].__module__ == "calibration.registration.align_images"


@pytest.mark.parametrize("name", [*PACKAGES, "clradar.plot", "clradar.model"])
def test_dir_shows_the_public_names_alone(name):
    package = importlib.import_module(name)
    assert dir(package) == sorted(package.__all__)


def test_the_package_is_imported_when_it_is_used():
    program = """
import sys, clradar
assert not {"numpy", "clradar.model"} & set(sys.modules), sorted(sys.modules)
assert clradar.Capture and "pyopencl" not in sys.modules
assert callable(clradar.backproject) and "pyopencl" in sys.modules
assert not {"trimesh", "scipy", "skimage", "matplotlib", "h5py"} & set(sys.modules)
from clradar import *
assert backproject is clradar.backproject and open_dataset and hand.HandPose
assert not hasattr(clradar, "no_such_name")
"""
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True)

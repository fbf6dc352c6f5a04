"""`clradar.calibration` and `clradar.measurement_io`: the packages of these names, not copies."""

from __future__ import annotations

import importlib
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from installed_wheel import ROOT, Environment, built_wheel

import calibration
import clradar
import measurement_io

SAME = """
import importlib, inspect, pkgutil, sys
{first}
import clradar.calibration, clradar.measurement_io, calibration, measurement_io

def loaded(package, prefix):
    for module in pkgutil.walk_packages(package.__path__, prefix):
        if module.name.startswith("clradar."):  # this name first
            yield importlib.import_module(module.name), module.name
        yield importlib.import_module(module.name.removeprefix("clradar.")), module.name

count = 0
for package, prefix in (
    (calibration, "calibration."), (measurement_io, "clradar.measurement_io."),
    (calibration, "clradar.calibration."), (measurement_io, "measurement_io."),
):
    for module, name in loaded(package, prefix):
        own = name.removeprefix("clradar.")
        assert module is sys.modules[own] is importlib.import_module(f"clradar.{{own}}"), name
        assert module.__name__ == module.__spec__.name == own, module.__spec__
        count += 1

# A module that was loaded twice has its classes twice.
seen = {{}}
for module in list(sys.modules.values()):
    if (getattr(module, "__name__", None) or "").split(".")[0] in ("calibration", "measurement_io"):
        for item in vars(module).values():
            if inspect.isclass(item):
                key = item.__module__, item.__qualname__
                assert seen.setdefault(key, item) is item, key
assert clradar.calibration is calibration and clradar.measurement_io is measurement_io
assert callable(measurement_io.describe), "a module has taken the function's place"
print(count > 200, len(seen) > 100)
"""
ORDERS = (
    "",
    "import calibration, measurement_io; import clradar.measurement_io.describe",
    "from clradar.measurement_io.maroon import frame; import clradar.calibration.hand_fit.result",
)


def output_of(*arguments: str, **variables: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.stdout.strip()


@pytest.mark.parametrize("first", ORDERS)
def test_every_module_is_one_by_both_names(first: str) -> None:
    assert output_of("-c", SAME.format(first=first)) == "True True"


def test_names_below_are_the_same_objects() -> None:
    second = importlib.import_module("clradar.calibration.hand_fit.result")
    assert second.HandFit is calibration.HandFit
    assert clradar.calibration.HandFit is calibration.HandFit
    with pytest.raises(ModuleNotFoundError, match=r"clradar\.calibration\.hand_fits"):
        importlib.import_module("clradar.calibration.hand_fits")


def test_what_was_pickled_by_one_name_is_read_by_the_other(tmp_path: Path) -> None:
    box = clradar.measurement_io.MaskBox(np.zeros(3), np.ones(3), False)
    file = tmp_path / "box"
    file.write_bytes(pickle.dumps(box))
    assert type(pickle.loads(file.read_bytes())) is measurement_io.MaskBox
    # A name by which it was not written, as `pickle` writes a function or a class of that module.
    second = b"cclradar.measurement_io.maroon.metadata\nMaskBox\n."
    assert pickle.loads(second) is measurement_io.MaskBox
    code = (
        "import pickle, sys; box = pickle.load(open(sys.argv[1], 'rb'))\n"
        "from clradar.measurement_io import MaskBox; print(type(box) is MaskBox)"
    )
    assert output_of("-c", code, str(file)) == "True"


def test_scripts_run_by_the_second_name() -> None:
    said = output_of("-m", "clradar.calibration.scripts.align", "--help", COLUMNS="100")
    assert "python -m clradar.calibration.scripts.align" in said
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    return built_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture
def installed(wheel: Path, tmp_path: Path) -> Environment:
    return Environment(tmp_path / "venv", wheel)


WHERE = "import clradar, {0}, clradar.{0} as second; print(second is {0}, {0}.__file__)"
USE = "from clradar.{0} import {1}; print({1}.__name__)"
NAMES = {"calibration": "align", "measurement_io": "open_capture"}


def other_package(installed: Environment, name: str) -> Path:
    """Install another package, which has a module of that name; return its main file."""
    lost = installed.packages / name / "__init__.py"
    lost.write_text("raise SystemExit('the other package ran')\n")
    record = installed.packages / "uncertainty_calibration-0.1.4.dist-info"
    record.mkdir()
    (record / "METADATA").write_text("Metadata-Version: 2.1\nName: uncertainty-calibration\n")
    (record / "RECORD").write_text(f"{name}/__init__.py,,\n{name}/utils.py,,\n")
    return lost


def test_both_names_work_from_a_wheel(installed: Environment) -> None:
    for name in NAMES:
        same, file = installed.run(WHERE.format(name)).split(maxsplit=1)
        assert (same, Path(file)) == ("True", installed.packages / name / "__init__.py")


@pytest.mark.parametrize("name", NAMES)
def test_a_package_that_has_overwritten_ours_is_named(installed: Environment, name: str) -> None:
    lost = other_package(installed, name)
    run = "import sys; from clradar.cli import main; main(['devices'])"
    for code in (USE.format(name, NAMES[name]), f"import clradar; clradar.{name}", run):
        said = installed.run(code).splitlines()[-1]
        assert f"{lost}: expected the file of clradar's own package '{name}', got that of " in said
        assert "'uncertainty-calibration'; uninstall that, then install clradar again" in said
    assert len(installed.run(run).splitlines()) == 1


def test_a_file_that_another_package_took_away_is_named(installed: Environment) -> None:
    (installed.packages / "calibration" / "__init__.py").unlink()
    said = installed.run(USE.format("calibration", "align")).splitlines()[-1]
    assert "calibration/__init__.py: expected the file of clradar's own package" in said
    assert "another package has taken away; install clradar again" in said


def test_a_package_that_hides_a_checkout_is_named(installed: Environment) -> None:
    # A checkout is on the path after the packages.
    hiding = other_package(installed, "calibration")
    for name in ("clradar", "measurement_io"):
        (installed.packages / name).rename(installed.packages / f"no_{name}")
    (installed.packages / "checkout.pth").write_text(f"{ROOT}\n")
    said = installed.run(USE.format("calibration", "align")).splitlines()[-1]
    assert f"{hiding}: hides clradar's own package 'calibration' by its name" in said
    assert "it belongs to the package 'uncertainty-calibration': uninstall that" in said
    assert installed.run(USE.format("measurement_io", "open_capture")) == "open_capture"

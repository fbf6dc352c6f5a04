"""Fixtures that all tests share."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import Cli

import clradar

# Nobody pulls the plug: the disk need not have a file before a test goes on.
os.fsync = lambda handle: None

HERE = Path(__file__).parent


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config.option, "loadscopereorder"):  # in the order here, not by number of tests
        config.option.loadscopereorder = False
    worker = getattr(config, "workerinput", {"workerid": "gw0", "workercount": 1})
    if [Path(arg).resolve() for arg in config.args] == [HERE]:
        # Each process of pytest-xdist begins with other files, so that one alone compiles each:
        # with the assertions that pytest writes anew that takes longer than all else before tests.
        files = sorted(str(path) for path in HERE.rglob("test_*.py"))
        first = int(worker["workerid"][2:]) * len(files) // worker["workercount"]
        config.args[:] = files[first:] + files[:first]


NEED_A_DEVICE = (
    *("bench", "calibration/hand_fit", "calibration/roughness"),
    *("calibration/scripts", "cli", "dataset", "fuzz", "imaging", "motion", "opencl", "phasors"),
    *("rigs", "tracing", "view", "arrays/test_gains_and_boresights.py"),
    "compare/test_spread.py",
    *("calibration/registration/test_align_mesh.py", "calibration/registration/test_register.py"),
    *("hand/test_flesh.py", "hand/test_hand.py", "test_doctests.py", "test_examples.py"),
    *("test_validation.py",),
)
"""Folders and files of tests that are marked `device` as a whole."""


FIRST = (
    *("test_results_stay.py", "test_plot.py", "calibration/channels/test_channels.py"),
    *("view/test_view_browser.py", "opencl/test_ways.py", "imaging/test_placement.py"),
    *("cli/test_image_parts.py", "dataset/test_dataset_engine.py", "cli/test_process_command.py"),
    *("cli/test_program.py", "motion/test_moving_sweep.py", "jobs/test_job.py"),
    *("calibration/registration/test_align.py", "calibration/registration/test_register.py"),
    *("calibration/test_conventions.py", "tracing/test_expected.py", "test_doctests.py"),
    *("test_examples.py", "test_platforms.py", "test_validation.py"),
)
"""Files that take long: one that begins last keeps one process busy alone. One of the first three
compiles kernels: with more of them, each process would compile the same."""


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> Iterator[None]:
    items.sort(key=lambda item: item.path)
    yield
    named = config.option.markexpr  # what takes minutes, and the memory checker, only by name
    aside = [name for name in ("slow", "memcheck") if name not in named]
    left_out = [item for item in items if any(item.get_closest_marker(name) for name in aside)]
    config.hook.pytest_deselected(items=left_out)
    rank = {HERE / name: i for i, name in enumerate(FIRST)}
    aside_too = set(left_out)
    items[:] = sorted(
        (item for item in items if item not in aside_too),
        key=lambda item: rank.get(item.path, len(FIRST)),
    )
    for item in items:
        place = item.path.relative_to(HERE)
        whole = any(str(path) in NEED_A_DEVICE for path in (place, *place.parents))
        if whole or "device" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.device)


@pytest.fixture(autouse=True)
def no_device_but_where_it_is_marked(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that `pytest -m "not device"` passes where there is none."""
    if request.node.get_closest_marker("device") is None:

        def none() -> None:
            pytest.fail("this test uses an OpenCL device: mark it with pytest.mark.device")

        monkeypatch.setattr("clradar.opencl.device.platforms", none)
        monkeypatch.setenv("OCL_ICD_VENDORS", str(HERE / "none"))  # for the processes it starts


def _device_names() -> list[str]:
    """PoCL, which comes with the install, and what CLRADAR_TEST_DEVICES lists (comma separated)."""
    listed = os.environ.get("CLRADAR_TEST_DEVICES", "").split(",")
    return list(dict.fromkeys(["pocl", *(name.strip() for name in listed if name.strip())]))


@pytest.fixture(scope="session", params=_device_names())
def device(request: pytest.FixtureRequest) -> clradar.Device:
    """An opened device. A missing one is an error, never a skip."""
    return clradar.open_device(request.param)


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    """Commands in an empty folder, with PoCL."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")
    return Cli(capsys)

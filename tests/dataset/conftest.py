"""Data sets that several tests read, and copies that a test may damage."""

import shutil
from pathlib import Path

import faulty_samples
import pytest
from dataset_plans import DEVICE, LIGHT, PLAN

from clradar.dataset import run, runs


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """The data set of `PLAN`, whole; not to be changed."""
    folder = tmp_path_factory.mktemp("dataset") / "made"
    result = run(PLAN, folder, device=DEVICE)
    assert (result.made, result.samples, result.aside) == (5, 5, ())
    return folder


@pytest.fixture(scope="module")
def quick_runs():
    """Have runs make each sample once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "make_sample", faulty_samples.make_once)
        yield


@pytest.fixture(scope="module")
def light(quick_runs, tmp_path_factory):
    """The data set of `LIGHT`, whole; not to be changed."""
    folder = tmp_path_factory.mktemp("dataset") / "light"
    run(LIGHT, folder, device=DEVICE)
    return folder


@pytest.fixture
def faults():
    """Say which samples fail; of this process and of the cluster's."""
    with faulty_samples.faults({}) as plan_faults:
        yield plan_faults


@pytest.fixture
def light_copy(light, tmp_path):
    return Path(shutil.copytree(light, tmp_path / "copy"))

"""Fixtures that all tests share."""

from __future__ import annotations

import os

import costs
import pytest

import clradar

# Nobody pulls the plug: the disk need not have a file before a test goes on.
os.fsync = lambda handle: None


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--costs", metavar="FILE", help="write processor seconds by file and fixture")


def pytest_configure(config: pytest.Config) -> None:
    # Not by its hooks here: fixtures of the session would not be seen.
    config.pluginmanager.register(costs)


def _device_names() -> list[str]:
    """PoCL, which comes with the install, and what CLRADAR_TEST_DEVICES lists (comma separated)."""
    listed = os.environ.get("CLRADAR_TEST_DEVICES", "").split(",")
    return list(dict.fromkeys(["pocl", *(name.strip() for name in listed if name.strip())]))


@pytest.fixture(scope="session", params=_device_names())
def device(request: pytest.FixtureRequest) -> clradar.Device:
    """An opened device. A missing one is an error, never a skip."""
    return clradar.open_device(request.param)

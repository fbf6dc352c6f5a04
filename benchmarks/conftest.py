"""Fixtures of the benchmarks: the device, the number of repetitions, inputs made once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import clradar

ROUNDS = 5


@pytest.fixture(scope="session")
def device() -> clradar.Device:
    """The device of CLRADAR_DEVICE, or the one that would be used."""
    return clradar.open_device()


@pytest.fixture
def measured(
    request: pytest.FixtureRequest, benchmark: Any, device: clradar.Device
) -> Callable[[Callable[[], Any]], Any]:
    """Time some work after a first run of it, which compiles, and return what it returns."""
    benchmark.extra_info["device"] = device.info.label
    mesh = getattr(request.node, "callspec", None) and request.node.callspec.params.get("scene")
    if mesh:
        benchmark.group += f", {mesh} mesh"

    def run(work: Callable[[], Any]) -> Any:
        return benchmark.pedantic(work, rounds=ROUNDS, warmup_rounds=1)

    return run

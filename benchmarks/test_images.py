"""The image by every method, against numba on range profiles and numpy, results compared."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

import clradar
from clradar.bench.images import ExactImage, PaperVolume, noise
from clradar.bench.timing import relative_rms_db

Measured = Callable[[Callable[[], Any]], Any]

PLANES = 5
"""Of the paper's 81, which `clradar bench` takes: the planning of "fast" counts more with fewer."""

RANGE_DB = -50.0
"""Linear interpolation between range bins: -54 dB."""

FAST_DB = -50.0 + 1.5
"""The default tolerance, and the error of the image by range profiles."""

FLOAT32_DB = -100.0
"""Two ways to do the same float32 sums of 10^6 terms."""


@pytest.fixture(scope="module")
def image(device: clradar.Device) -> PaperVolume:
    return PaperVolume(device, noise(), PLANES)


@pytest.fixture(scope="module")
def by_range(image: PaperVolume) -> np.ndarray:
    return image.ours("range")


@pytest.fixture(scope="module")
def plane(device: clradar.Device) -> ExactImage:
    return ExactImage(device, noise())


IMAGES = "image, 201 x 201 x 5"
PLANE = "exact sum, 5.8 G terms"


@pytest.mark.benchmark(group=IMAGES)
def test_fast(measured: Measured, image: PaperVolume, by_range: np.ndarray) -> None:
    data: np.ndarray = measured(partial(image.ours, "fast"))
    assert relative_rms_db(data, by_range) <= FAST_DB


@pytest.mark.benchmark(group=IMAGES)
def test_range(measured: Measured, image: PaperVolume, plane: ExactImage) -> None:
    measured(partial(image.ours, "range"))
    by_range = clradar.backproject(
        plane.capture, plane.grid, method="range", device=plane.device
    ).data.ravel()
    assert relative_rms_db(by_range, plane.ours()) <= RANGE_DB


@pytest.mark.benchmark(group=IMAGES)
def test_numba_on_range_profiles(
    measured: Measured, image: PaperVolume, by_range: np.ndarray
) -> None:
    """The profiles are given."""
    data: np.ndarray = measured(image.theirs)
    assert relative_rms_db(data, by_range) <= FLOAT32_DB


@pytest.mark.benchmark(group=PLANE)
def test_exact(measured: Measured, plane: ExactImage) -> None:
    data: np.ndarray = measured(plane.ours)
    assert relative_rms_db(data, plane.theirs()) <= FLOAT32_DB


@pytest.mark.benchmark(group=PLANE)
def test_numpy_gemm(measured: Measured, plane: ExactImage) -> None:
    data: np.ndarray = measured(plane.theirs)
    assert relative_rms_db(data, plane.ours()) <= FLOAT32_DB

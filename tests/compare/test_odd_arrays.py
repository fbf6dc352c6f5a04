"""Values at the ends of what numbers hold: a result or one clear error, and no other warning.

Warnings are errors in the tests.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from nightly import nightly

from clradar import DepthMap, Volume, VoxelGrid, compare
from clradar.compare.metrics import METRICS
from clradar.errors import ClradarError, ModelError
from clradar.plot import image_figure
from clradar.report import ReportImage, html_report

pytestmark = pytest.mark.filterwarnings("ignore:compare. an overlap of:clradar.ClradarWarning")

N = 13
AXIS_M = np.arange(N) * 1e-3
RNG = np.random.default_rng(0)
NOISE = RNG.normal(size=(7, N, N)) + 1j * RNG.normal(size=(7, N, N))


def volume(data: np.ndarray, first_m: float = 0.29, step_m: float = 1e-3) -> Volume:
    return Volume(data, VoxelGrid([0, 0, first_m], [1e-3, 1e-3, step_m], (N, N, len(data))))


def spike(value: complex) -> Volume:
    data = NOISE.copy()
    data[3, 4, 5] = value
    return volume(data)


def depth_map(**changes: Any) -> DepthMap:
    fields = {"depth_m": np.full((N, N), 0.3), "amplitude": np.abs(NOISE[0]), "x_m": AXIS_M}
    fields |= {"y_m": AXIS_M, **changes}
    return DepthMap(**fields)


def depths(value: float) -> np.ndarray:
    made = np.full((N, N), 0.3)
    made[3, 4] = value
    return made


IMAGES: dict[str, Callable[[], Volume | DepthMap]] = {
    "at the end of float32": lambda: spike(3.4e38),
    "parts that fit, modulus that does not": lambda: spike(3e38 + 3e38j),
    "alternating ends": lambda: volume(np.where(np.indices(NOISE.shape).sum(0) % 2, 3e38, -3e38)),
    "denormals": lambda: volume(NOISE * 1e-44),
    "far away": lambda: volume(NOISE, 1e300),
    "steps of 16 m": lambda: volume(NOISE, 0.0, 16.0),
    "tiny steps": lambda: volume(NOISE, 0.3, 1e-300),
    "a depth of 1e300 m": lambda: depth_map(depth_m=depths(1e300)),
    "all decades": lambda: depth_map(amplitude=10.0 ** RNG.uniform(-45, 38, (N, N))),
    "no depth": lambda: depth_map(depth_m=np.full((N, N), np.nan)),
    "axis over all numbers": lambda: depth_map(x_m=np.linspace(-1, 1, N) * 1.7e308),
    "axis of denormals": lambda: depth_map(x_m=AXIS_M * 1e-300, y_m=AXIS_M * 1e-300),
}

USES: dict[str, Callable[[Any, Any], Any]] = {
    "itself": lambda image, _: compare(image, image),
    "another": lambda image, plain: compare(image, plain),
    "back": lambda image, plain: compare(plain, image),
    "deep": lambda image, plain: compare(image, plain, dynamic_range_db=1000.0),
    "maximum": lambda image, _: image.max_projection() if isinstance(image, Volume) else None,
}

DRAWN: dict[str, Callable[[Any], Any]] = {
    "figure": image_figure,
    "page": lambda image: html_report(ReportImage("a", image), [ReportImage("b", image)]),
}


def refusal(use: Callable[[Any, Any], Any], *images: Any) -> str | None:
    """The message of the one kind of error that may come, None if there is a result."""
    try:
        use(*images)
    except ClradarError as error:
        return str(error)
    return None


def assert_used(name: str, uses: dict[str, Callable[..., Any]], *others: Any) -> None:
    message = refusal(IMAGES[name])
    if message is not None:
        assert "expected" in message
        return
    for use in uses.values():
        message = refusal(use, IMAGES[name](), *others)
        assert message is None or "expected" in message


@pytest.mark.parametrize("name", IMAGES)
def test_a_result_or_one_clear_error(name):
    assert_used(name, USES, volume(NOISE))


@pytest.mark.parametrize("name", nightly(IMAGES))
def test_drawings_or_one_clear_error(name, monkeypatch):
    monkeypatch.setattr("clradar.report.page.FIGURE_DPI", 10)
    assert_used(name, DRAWN)


def test_what_is_refused_says_why():
    with pytest.raises(ModelError, match=r"Volume\.data: expected amplitudes within the range of"):
        spike(3e38 + 3e38j).max_projection()
    with pytest.raises(ModelError, match="VoxelGrid: expected a distance of the farthest voxel"):
        IMAGES["far away"]()
    with pytest.raises(ModelError, match=r"dynamic_range_db: expected at most 1000 dB, got 2000"):
        compare(spike(1.0), spike(1.0), dynamic_range_db=2000.0)
    with pytest.raises(ClradarError, match="depths within 20 m of each other, got them over"):
        compare(IMAGES["steps of 16 m"](), IMAGES["steps of 16 m"]())


def test_the_level_has_no_influence_up_to_the_ends_of_float32():
    """Twice the maximum is beyond float32, and a power of two changes no mantissa."""
    high = volume((NOISE * 2.0**125).astype(np.complex64))
    low = volume((NOISE * 2.0**-60).astype(np.complex64))
    plain = volume(NOISE.astype(np.complex64))
    for other in (high, low):
        assert np.array_equal(other.depth_map().depth_m, plain.depth_map().depth_m, equal_nan=True)
        found = compare(other, plain)
        assert [getattr(found, name) for name in METRICS] == [
            getattr(compare(plain, plain), name) for name in METRICS
        ]

"""The hand's flesh on a device, against its float64 reference."""

import numpy as np
import pytest
from flesh_reference import digits, distances_m, gradients, part_distances_m, rows
from nightly import nightly

import clradar
from clradar.errors import DeviceError
from clradar.hand import POSES, hand_mesh, posed_skeleton, random_pose, random_shape
from clradar.hand.flesh import Flesh, FleshField, grown_flesh
from clradar.hand.mesh import DEFAULT_EDGE_LENGTH_M
from clradar.opencl import Buffers

COARSE_M = 3e-3

# Coordinates and distances below 0.25 m are rounded to float32 by at most 2^-27 m, about twelve
# times on the way from a point to its distance: 9e-8 m. Cones left out far away change less.
DISTANCE_TOLERANCE_M = 1e-7

# A gradient is a direction from the axis of a cone, mixed by shares of blends: the error of a
# distance over 1 mm or more, which are all points but those within 1 mm of an axis.
GRADIENT_TOLERANCE = DISTANCE_TOLERANCE_M / 1e-3


def flesh_of(name: str) -> Flesh:
    """Letters, and hands of which pose (wrist, too) and shape are drawn."""
    if name in POSES:
        return grown_flesh(posed_skeleton(POSES[name]))
    rng = np.random.default_rng(int(name))
    return grown_flesh(posed_skeleton(random_pose(rng), random_shape(rng)))


def points_around(flesh: Flesh, count: int) -> np.ndarray:
    low_m, high_m = flesh.bounds_m()
    return np.random.default_rng(5).uniform(low_m, high_m, (count, 3))


@pytest.fixture(params=["F", "1001", *nightly(["S", "1002"])])
def flesh(request: pytest.FixtureRequest) -> Flesh:
    return flesh_of(request.param)


def test_the_field_is_that_of_the_reference(flesh, device):
    points_m = points_around(flesh, 8_001)
    expected_m, few_m = distances_m(flesh, points_m), points_m[:2_003]
    with Buffers(device) as buffers:
        field = FleshField(flesh, DEFAULT_EDGE_LENGTH_M, buffers)
        found_m, part = field.distances_m(points_m), field.nearest_parts(points_m)
        slopes = field.gradients(few_m)
        assert field.distances_m(np.zeros((0, 3))).shape == (0,)
        assert field.gradients(np.zeros((0, 3))).shape == (0, 3)
    assert (found_m.dtype, part.dtype) == (np.float32, np.int32)
    np.testing.assert_allclose(found_m, expected_m, rtol=0, atol=DISTANCE_TOLERANCE_M)
    error = np.abs(slopes - gradients(flesh, few_m)).max(axis=1)
    # But for the few points next to an axis, or with a crease of the plain minima within a step.
    assert (error < GRADIENT_TOLERANCE).mean() > 0.999
    assert set(np.unique(part)) == set(range(6))
    apart_m = part_distances_m(points_m, rows(flesh.palm), digits(flesh))
    # Between two that are equally far, rounding of both decides.
    excess_m = np.take_along_axis(apart_m, part[None], axis=0)[0] - apart_m.min(axis=0)
    assert excess_m.max() <= 2 * DISTANCE_TOLERANCE_M


def test_nodes_have_the_distance_near_the_surface_and_its_sign_elsewhere(flesh, device):
    spacing_m = 5e-3
    with Buffers(device) as buffers:
        field = FleshField(flesh, spacing_m, buffers)
        found_m, first_m = field.node_distances_m(), field.first_m
    low_m, high_m = flesh.bounds_m()
    # Nodes enough around the flesh, and not many more: less than a cell of four, at each end.
    last_m = first_m + spacing_m * (np.array(found_m.shape) - 1)
    assert (first_m < low_m).all()
    assert (last_m > high_m - 0.5 * spacing_m).all()
    assert (last_m < high_m + 5 * spacing_m).all()
    index = np.stack(np.meshgrid(*map(np.arange, found_m.shape), indexing="ij"), axis=-1)
    expected_m = distances_m(flesh, first_m + spacing_m * index.reshape(-1, 3))
    found_m = found_m.reshape(-1)
    # All that marching cubes mixes: nodes of an edge through the surface, which are a spacing long.
    close = np.abs(expected_m) <= spacing_m
    assert close.sum() > 2_000
    np.testing.assert_allclose(found_m[close], expected_m[close], rtol=0, atol=DISTANCE_TOLERANCE_M)
    assert (np.sign(found_m[~close]) == np.sign(expected_m[~close])).all()


def test_a_device_that_is_too_small_is_an_error(device):
    small = clradar.open_device(device.info.selector, memory_limit_bytes=20_000)
    with pytest.raises(DeviceError, match="choose another device"):
        hand_mesh("F", COARSE_M, device=small)

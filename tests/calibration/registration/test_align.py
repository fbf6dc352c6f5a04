"""Alignment of images: known motions are found, unobservable ones named, failures explained."""

from functools import partial

import numpy as np
import pytest
from hand_registrations import CENTRE_M, errors, motion
from nightly import nightly
from scipy.spatial.transform import Rotation

import clradar
from calibration import Alignment, align
from calibration.registration.rigid_motion import exp_twist, kabsch, moved
from clradar.errors import CompareError, ModelError

PIXEL_M = 2e-3

EXACT_M = 0.05 * PIXEL_M
"""Of exact depths: a point is measured from planes through neighbours up to a pixel p away, which a
surface of radius R leaves by p^2 / 2R there: 0.08 mm for p = 2 mm, R = 25 mm, rounded up."""

EXACT_DEG = float(np.degrees(EXACT_M / 0.03))
"""The same depth error over the object's radius of 30 mm."""


def potato(p):
    """An ellipsoid with bumps, as an implicit function: positive inside; metres."""
    radius = np.linalg.norm(p / [0.040, 0.055, 0.025], axis=-1)
    u, v = p[..., 0] / 0.01, p[..., 1] / 0.01
    bumps = 0.06 * np.sin(1.1 * u + 0.3) * np.cos(0.9 * v) + 0.04 * np.sin(1.7 * v + 0.8 * u)
    return 1.0 + bumps - radius


def plate(p):
    return np.min([0.04 - np.abs(p[..., 0]), 0.03 - np.abs(p[..., 1]), 1e-3 - np.abs(p[..., 2])], 0)


def depth_map(body, transform=None, pixel_m=PIXEL_M):
    """Depths of a body along parallel rays in z, to a micrometre."""
    transform = np.eye(4) if transform is None else transform
    axis_m = np.arange(-0.08, 0.08 + pixel_m / 2, pixel_m)
    x, y = np.meshgrid(axis_m, axis_m)
    back = np.linalg.inv(transform)

    def inside(z):
        return body(np.stack([x, y, z], axis=-1) @ back[:3, :3].T + back[:3, 3] - CENTRE_M) > 0

    low, high = np.full(x.shape, np.nan), np.full(x.shape, np.nan)
    for z in np.arange(0.24, 0.361, 1e-3):
        first = np.isnan(high) & inside(np.full(x.shape, z))
        low[first], high[first] = z - 1e-3, z
    for _ in range(10):
        middle = 0.5 * (low + high)
        hit = inside(middle)
        low, high = np.where(hit, low, middle), np.where(hit, middle, high)
    return of_depth(high, axis_m)


def of_depth(depth_m, axis_m, amplitude=None):
    seen = ~np.isnan(depth_m)
    return clradar.DepthMap(
        depth_m, 1.0 * seen if amplitude is None else amplitude, axis_m, axis_m, 15.0
    )


def noisy(depth, sigma_m, seed):
    noise_m = sigma_m * np.random.default_rng(seed).normal(size=depth.depth_m.shape)
    return of_depth(depth.depth_m + noise_m, depth.x_m, depth.amplitude)


def without(depth, keep):
    return of_depth(np.where(keep, depth.depth_m, np.nan), depth.x_m)


def assert_near(result, truth, tolerance_m, tolerance_deg):
    off_m, off_deg = errors(result.transform, truth)
    assert off_m <= tolerance_m
    assert off_deg <= tolerance_deg


@pytest.fixture(scope="module")
def original():
    return depth_map(potato)


MOTION = motion((3, 4, -14), (0.010, 0.014, -0.010))


@pytest.mark.parametrize("truth", [MOTION, *nightly([motion((-9, 9, 8), (-0.011, 0.012, 0.012))])])
def test_finds_a_known_motion(original, truth):
    measured = depth_map(potato, truth)
    result = align(measured, original)
    assert_near(result, truth, EXACT_M, EXACT_DEG)
    assert result.converged
    assert result.degenerate_directions == ()
    assert result.inlier_share > 0.95
    assert result.rms_m < EXACT_M
    # The transform carries simulated points onto the measured surface, not the other way round.
    nearest_m = np.linalg.norm(
        moved(result.transform, original.points_m())[:, None] - measured.points_m()[None], axis=2
    ).min(axis=1)
    assert np.median(nearest_m) < PIXEL_M
    turned_deg = np.degrees(Rotation.from_matrix(truth[:3, :3]).magnitude())
    assert result.rotation_deg == pytest.approx(turned_deg, abs=EXACT_DEG)
    came_from_m = moved(np.linalg.inv(truth), result.centre_m[None])[0]
    np.testing.assert_allclose(result.shift_m, result.centre_m - came_from_m, atol=2 * EXACT_M)
    shift_mm = 1e3 * np.linalg.norm(result.shift_m)
    numbers = f"shifted by {shift_mm:.2f} mm", f"turned by {result.rotation_deg:.2f}"
    for part in (*numbers, "simulated amplitude", "deviation", "Converged"):
        assert part in result.report()


def test_clutter_on_one_side_and_what_the_other_lacks_do_not_pull(original):
    measured = depth_map(potato, MOTION)
    depth_m = measured.depth_m.copy()
    depth_m[:6] = 0.36  # a wall behind, which only the measurement shows
    result = align(of_depth(depth_m, measured.x_m), original, search_deg=15)
    assert_near(result, MOTION, EXACT_M, EXACT_DEG)
    rows = np.nonzero(measured.mask.any(axis=1))[0]
    keep = np.arange(len(measured.y_m))[:, None] < rows[0] + 2 * len(rows) // 3
    part = without(measured, keep)
    result = align(part, original, search_deg=15)
    assert_near(result, MOTION, EXACT_M, EXACT_DEG)
    assert result.inlier_share == pytest.approx(part.mask.sum() / measured.mask.sum(), abs=0.05)


def test_noise_within_the_covariance(original):
    """Residuals of 0.5 mm on each side: the error agrees with the covariance."""
    measured = depth_map(potato, MOTION)
    result = align(noisy(measured, 5e-4, 0), noisy(original, 5e-4, 100), search_deg=5)
    assert result.converged
    off = result.transform @ np.linalg.inv(MOTION)
    turn = Rotation.from_matrix(off[:3, :3]).as_rotvec()
    shift_m = moved(off, result.centre_m[None])[0] - result.centre_m
    error = np.concatenate([turn, shift_m])
    distance2 = error @ np.linalg.solve(result.covariance, error)
    assert distance2 < 22.5  # chi squared, 6 degrees of freedom: one in a thousand is beyond
    # Noise of a point and of a plane, less what the choice of the nearest takes away.
    assert 0.7 * 5e-4 < result.rms_m < np.sqrt(2) * 5e-4


def test_bright_parts_count_more(original):
    """The middle is 0.5 mm farther away, which no rotation compensates: the brighter part wins."""
    middle = np.broadcast_to(np.abs(original.x_m) < 0.015, original.mask.shape)
    # Noise of the same size, so that neither part is an outlier of the other.
    bent = noisy(of_depth(original.depth_m + 5e-4 * middle, original.x_m), 5e-4, 0)

    def mean_depth_m(bright):
        amplitude = np.where(bright, 1.0, 0.25) * original.mask
        result = align(of_depth(bent.depth_m, bent.x_m, amplitude), original, search_deg=5)
        return (moved(result.transform, original.points_m()) - original.points_m())[:, 2].mean()

    sides_m, middle_m = mean_depth_m(~middle), mean_depth_m(middle)
    assert 0.0 < sides_m < middle_m - 5e-5
    assert middle_m < 5e-4


@pytest.mark.parametrize("sigma_m", [0.0, *nightly([1e-3])])
def test_unobservable_directions_of_a_plate_do_not_move(sigma_m):
    truth = motion((8, -5, 0), (0.006, -0.004, 0.003))
    measured = noisy(depth_map(plate, truth), sigma_m, 0)
    simulated = noisy(depth_map(plate), sigma_m, 1)
    result = align(measured, simulated, search_deg=5)
    names = result.degenerate_directions
    assert len(names) == 3
    assert [name.startswith("the shift along") for name in names] == [True, True, False]
    assert "the rotation about" in names[2]
    # Observable: tilt of the normal, distance along it. Noise of 1 mm on a thousand points of
    # 25 mm radius leaves 0.1 degrees; ten times that also covers the bias from noisy normals.
    normal, found = truth[:3, 2], result.transform[:3, 2]
    assert np.degrees(np.arccos(min(1.0, normal @ found))) < (0.1 if sigma_m == 0 else 1.0)
    off_m = normal @ (
        moved(result.transform, CENTRE_M[None])[0] - CENTRE_M - [0.006, -0.004, 0.003]
    )
    assert abs(off_m) < (EXACT_M if sigma_m == 0 else 3e-4)
    # Unobservable, so constrained: no rotation about the normal, no shift in the plane.
    assert abs(result.rotation_vector @ result.transform[:3, 2]) < np.radians(0.5)
    in_plane_m = result.shift_m - normal * (normal @ result.shift_m)
    assert np.linalg.norm(in_plane_m) < 5e-4
    assert "constrained to no motion" in result.report()
    assert np.sqrt(np.linalg.eigvalsh(result.covariance)[-3:]).min() > 0.9


def test_an_unfinished_fit_is_reported(original):
    with pytest.warns(clradar.ClradarWarning, match="align: the pose still changed in the last"):
        result = align(depth_map(potato, MOTION), original, max_iterations=1, search_deg=5)
    assert not result.converged
    assert "NOT converged" in result.report()
    assert result.iterations == 1


def empty(depth):
    return of_depth(np.full_like(depth.depth_m, np.nan), depth.x_m, np.ones(depth.depth_m.shape))


def few(depth):
    rows, columns = np.nonzero(depth.mask)
    keep = np.zeros(depth.mask.shape, bool)
    keep[rows[:10], columns[:10]] = True
    return without(depth, keep)


def scattered(depth):
    rng = np.random.default_rng(0)
    depth_m = np.where(rng.uniform(size=depth.mask.shape) < 0.03, 0.3, np.nan)
    return of_depth(depth_m + rng.uniform(-0.1, 0.1, depth.mask.shape), depth.x_m)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (empty, "expected a depth somewhere within 15 dB of the maximum, got none"),
        (few, "has 10 depth points, and 30 are the least"),
        (scattered, "depth points with enough neighbours within 5.0 mm for a normal"),
        (lambda depth: "a name.h5", "expected a Volume or a DepthMap, got str"),
    ],
)
def test_nothing_to_align(original, spoil, reason):
    for role in ("measured", "simulated"):
        pair = {"measured": original, "simulated": original, role: spoil(original)}
        with pytest.raises(CompareError, match=f"{role} image.*{reason}"):
            align(**pair)


def test_images_that_hardly_agree_are_a_failure(original):
    """Two plates side by side: a shift in their plane is unobservable, and without it they miss."""
    small = partial(depth_map, lambda p: plate(2.5 * p))
    with pytest.raises(CompareError, match="could not align, because the two hardly overlap"):
        align(
            small(motion(shift_m=(-0.05, 0, 0))), small(motion(shift_m=(0.05, 0, 0))), search_deg=5
        )
    corner = without(original, (original.x_m < -0.01) & (original.y_m[:, None] < 0.0))
    with pytest.raises(CompareError, match=r"only \d+% of the simulated amplitude .* 50% is the"):
        align(corner, original, min_inlier_share=0.5, search_deg=5)


@pytest.mark.parametrize(
    "option",
    [{"search_deg": 181}, {"min_inlier_share": 1.5}, {"max_rms_m": -1e-3}, {"max_iterations": 0}],
)
def test_options_are_checked(original, option):
    with pytest.raises(ModelError, match=next(iter(option))):
        align(original, original, **option)


@pytest.mark.slow
def test_wide_search_finds_a_quarter_turn(original):
    truth = motion((0, 0, 90), (0.01, 0, 0))
    result = align(depth_map(potato, truth), original, search_deg=180)
    assert_near(result, truth, EXACT_M, EXACT_DEG)


@pytest.mark.parametrize("name", ["transform", "covariance", "centre_m"])
@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e308, 1e160, -1.0, 5e-324])
def test_an_alignment_of_any_numbers_is_refused_or_reported_without_warnings(name, value):
    """Warnings are errors here: a root of a negative variance, an overflow of a shift."""
    rng = np.random.default_rng(0)
    fields = {"transform": np.eye(4), "covariance": np.eye(6), "centre_m": CENTRE_M}
    refused = 0
    for _ in range(20):
        array = np.array(fields[name])
        array.flat[rng.choice(array.size, rng.integers(1, array.size + 1), replace=False)] = value
        try:
            found = Alignment(
                **{**fields, name: array}, rms_m=1e-3, inlier_share=0.9, iterations=5,
                converged=False, degenerate_directions=(), moved="mesh", overlap=0.5,
            )  # fmt: skip
        except ModelError:
            refused += 1
        else:
            assert found.report().startswith("The mesh is shifted by")
            assert len(found.to_dict()["remarks"]) == 2
    assert refused == 20 or np.abs(value) <= 1e9


def test_kabsch_and_twists_are_exact():
    rng = np.random.default_rng(1)
    points_m = rng.normal(size=(10, 3))
    centre_m, twist = rng.normal(size=3), rng.normal(size=6)
    truth = exp_twist(twist, centre_m)
    np.testing.assert_allclose(
        kabsch(points_m, moved(truth, points_m), np.ones(10)), truth, atol=1e-12
    )
    np.testing.assert_allclose(exp_twist(-twist, centre_m) @ truth, np.eye(4), atol=1e-12)
    # Halves add up, on both sides of where the series takes over.
    for size in (1e-9, 0.004, 0.015, 0.4):
        half = exp_twist(0.5 * size * twist, centre_m)
        np.testing.assert_allclose(half @ half, exp_twist(size * twist, centre_m), atol=1e-12)
    # A flat set must not come back mirrored.
    flat_m = points_m * [1, 1, 0]
    assert np.linalg.det(kabsch(flat_m, moved(truth, flat_m), np.ones(10))[:3, :3]) > 0

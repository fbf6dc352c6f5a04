"""The metrics against closed forms and formulas by hand, and objects that one image lacks."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clradar import ClradarWarning, DepthMap, Metrics, Volume, VoxelGrid, compare
from clradar.compare.images import MOST_DB, NEAR_DEPTH_M, NEAR_M, WEAKER_DB, cut_pair, disagreement
from clradar.compare.metrics import OVERLAP_BLUR_M, SSIM_SIGMA, SSIM_WINDOW, metrics_of, overlap
from clradar.errors import CompareError, ModelError

# Depths and coordinates are float64 sums and products of numbers below 1: a few units in the last
# place of 1, taken with a margin of about a hundred.
ROUNDING = 1e-13
# Amplitudes are float32, relative error 6e-8, which is 20 / ln(10) * 6e-8 = 5e-7 dB on a scale of
# 15 dB. Correlation and SSIM change by no more than a few times that share.
FLOAT32 = 1e-6

# The overlap's kernel is truncated twice, at exp(-16) = 1.1e-7 each.
OVERLAP_CUTS = 3e-7

MM = 1e-3
N_X, N_Y, N_Z = 40, 30, 21


def grid(z_first_mm: float = 290.0, x_first_mm: float = -20.0, n_x: int = N_X) -> VoxelGrid:
    """1 mm voxels; pixel [row, column] is at y = row - 15, x = x_first + column (mm)."""
    return VoxelGrid(
        np.array([x_first_mm, -15.0, z_first_mm]) * MM, np.full(3, MM), (n_x, N_Y, N_Z)
    )


def layer(amplitude: np.ndarray, z_index: int | np.ndarray = 10, **kwargs: Any) -> Volume:
    """A volume with `amplitude[y, x]` in the one layer `z_index` (one per pixel, or one for all).

    With nothing beside it along z, the parabola leaves each depth at its voxel's centre.
    """
    at = np.broadcast_to(z_index, amplitude.shape)
    data = np.where(np.arange(N_Z)[:, None, None] == at, amplitude, 0.0)
    return Volume(data.astype(np.complex64), grid(**kwargs))


def plate(rows: slice, columns: slice, level: float = 1.0) -> np.ndarray:
    amplitude = np.zeros((N_Y, N_X))
    amplitude[rows, columns] = level
    return amplitude


def texture(seed: int) -> np.ndarray:
    """Amplitudes spread over 30 dB, so that about half of them are clipped."""
    return 10.0 ** (np.random.default_rng(seed).uniform(-30.0, 0.0, (N_Y, N_X)) / 20.0)


def depth_map(
    amplitude: np.ndarray, depth_m: np.ndarray | float = 0.3, rng_db: float = 15.0
) -> DepthMap:
    n_y, n_x = amplitude.shape
    depth = np.broadcast_to(np.asarray(depth_m, dtype=float), amplitude.shape)
    return DepthMap(depth, amplitude, np.arange(n_x) * MM, np.arange(n_y) * MM, rng_db)


SPECKLE = pytest.mark.filterwarnings("ignore:compare. an overlap of:clradar.ClradarWarning")
"""Of textures of two seeds the overlap sees one full plate, the correlation no likeness."""

PLATE = plate(slice(5, 20), slice(10, 30))


@pytest.mark.parametrize("steps", [0, -7, 1])
def test_plane_shifted_in_depth(steps):
    metrics = compare(layer(PLATE), layer(PLATE, 10 + steps))
    shift_m = abs(steps) * MM
    assert (metrics.db_correlation, metrics.mask_iou) == (1.0, 1.0)
    assert metrics.ssim == pytest.approx(1.0, abs=ROUNDING)
    # A weight common to all pairs of points comes out of the sum: exp(-(shift / 2 blur)^2).
    expected = math.exp(-((shift_m / (2 * OVERLAP_BLUR_M)) ** 2))
    assert metrics.overlap == pytest.approx(expected, abs=OVERLAP_CUTS)
    assert metrics.depth_rmse_m == pytest.approx(shift_m, abs=ROUNDING)
    # Between parallel planes on the same pixels the nearest point is straight ahead.
    assert metrics.chamfer_simulated_to_measured_m == pytest.approx(shift_m, abs=ROUNDING)
    assert metrics.chamfer_measured_to_simulated_m == pytest.approx(shift_m, abs=ROUNDING)


def test_masks_that_share_a_part_and_none():
    # 20 x 10 and 20 x 10 pixels that share 20 x 4: 80 / (200 + 200 - 80).
    first, second, apart = (layer(plate(slice(0, 20), slice(at, at + 10))) for at in (0, 6, 15))
    assert compare(first, second).mask_iou == 80 / 320
    metrics = compare(first, apart)
    assert metrics.mask_iou == 0.0
    assert math.isnan(metrics.depth_rmse_m)
    # Columns 15 to 24 to the nearest measured column, 9: 6 to 15 mm, and the same backwards.
    assert metrics.chamfer_simulated_to_measured_m == pytest.approx(10.5 * MM, abs=ROUNDING)
    assert metrics.chamfer_measured_to_simulated_m == pytest.approx(10.5 * MM, abs=ROUNDING)
    record = json.loads(json.dumps(metrics.to_dict(), allow_nan=False))
    assert record["depth_rmse_m"] is None
    assert record["chamfer_simulated_to_measured_m"] == metrics.chamfer_simulated_to_measured_m


@pytest.mark.parametrize("blur_mm", [0.7, 5.0])
def test_overlap_against_all_pairs(blur_mm):
    """On uneven pixels, with depths between the voxels and pixels that have none."""
    rng = np.random.default_rng(6)
    x_m, y_m = (np.cumsum(rng.uniform(0.5, 1.5, n)) * MM for n in (N_X, N_Y))
    maps = []
    for seed in (50, 51):
        depth_m = np.where(
            rng.random((N_Y, N_X)) < 0.6, rng.uniform(0.29, 0.31, (N_Y, N_X)), np.nan
        )
        maps.append(DepthMap(depth_m, texture(seed), x_m, y_m, 30.0))
    points = [image.points_m() for image in maps]
    weights = [image.amplitude[image.mask].astype(np.float64) for image in maps]

    def product(i: int, j: int) -> float:
        distance = np.linalg.norm(points[i][:, None] - points[j][None], axis=2)
        return weights[i] @ np.exp(-((distance / (2e-3 * blur_mm)) ** 2)) @ weights[j]

    expected = product(0, 1) / math.sqrt(product(0, 0) * product(1, 1))
    assert 0.2 < expected < 0.99
    assert overlap(*maps, blur_mm * MM) == pytest.approx(expected, abs=OVERLAP_CUTS)
    assert overlap(*maps[::-1], blur_mm * MM) == pytest.approx(expected, abs=OVERLAP_CUTS)


@SPECKLE
def test_chamfer_against_all_pairs_and_correlation_against_numpy():
    """dB by hand: relative to each maximum, clipped, every pixel of the image."""
    rng, amplitudes = np.random.default_rng(5), (texture(7), texture(8) + 0.5 * texture(7))
    a, b = (layer(one, rng.integers(0, N_Z, (N_Y, N_X))) for one in amplitudes)
    points_a, points_b = a.depth_map().points_m(), b.depth_map().points_m()
    distance = np.linalg.norm(points_a[:, None] - points_b[None], axis=2)
    metrics = compare(a, b)
    expected = distance.min(axis=0).mean()
    assert metrics.chamfer_simulated_to_measured_m == pytest.approx(expected, abs=ROUNDING)
    expected = distance.min(axis=1).mean()
    assert metrics.chamfer_measured_to_simulated_m == pytest.approx(expected, abs=ROUNDING)
    clipped = [np.maximum(20 * np.log10(v / v.max()), -15.0).ravel() for v in amplitudes]
    expected = np.corrcoef(*clipped)[0, 1]
    assert metrics.db_correlation == pytest.approx(expected, abs=FLOAT32)


@SPECKLE
def test_ssim_by_hand():
    """Wang et al. 2004, written out for one image of exactly one window."""
    rng = np.random.default_rng(11)
    a, b = (10.0 ** (rng.uniform(-15.0, 0.0, (11, 11)) / 20.0) for _ in range(2))
    offset = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    line = np.exp(-0.5 * (offset / SSIM_SIGMA) ** 2)
    weight = np.outer(line, line) / np.outer(line, line).sum()
    x, y = (20 * np.log10(v / v.max()) / 15.0 + 1.0 for v in (a, b))
    mean_x, mean_y = (weight * x).sum(), (weight * y).sum()
    var_x, var_y = ((weight * v**2).sum() - (weight * v).sum() ** 2 for v in (x, y))
    cov = (weight * x * y).sum() - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    expected = ((2 * mean_x * mean_y + c1) * (2 * cov + c2)) / (
        (mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2)
    )
    # c2 = 9e-4 in the denominator magnifies the float32 error of the images.
    assert compare(depth_map(a), depth_map(b)).ssim == pytest.approx(expected, abs=10 * FLOAT32)


def test_depth_maps_and_volumes_agree():
    a, b = layer(texture(40), 3), layer(texture(41), 5)
    expected = compare(a, b)
    assert compare(a.depth_map(), b) == expected
    # A map that was cut further down is cut again, at the same pixels.
    assert compare(a.depth_map(30.0), b.depth_map(20.0)) == expected


def test_correlation_of_a_constant_image_is_nan():
    constant, other = layer(np.ones((N_Y, N_X))), layer(PLATE)
    for pair in ((constant, other), (other, constant), (constant, constant)):
        metrics = compare(*pair)
        assert math.isnan(metrics.db_correlation)
        assert math.isfinite(metrics.ssim)
        assert metrics.depth_rmse_m == 0.0


NOWHERE = replace(layer(PLATE).depth_map(), depth_m=np.full((N_Y, N_X), np.nan))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (layer(np.zeros((N_Y, N_X))), "0 everywhere"),
        (PLATE, "got ndarray"),
        (NOWHERE, "depth somewhere within 15 dB"),
        (layer(PLATE).depth_map(10.0), "15 dB.*cut at 10 dB"),
        (layer(PLATE, x_first_mm=-19.5), r"same pixels.*-20 to 19 mm|-19\.5 to 19\.5 mm.*in 40"),
        (layer(PLATE[:, :31], n_x=31), "x = -20 to 10 mm in 31"),
    ],
)
def test_images_that_cannot_be_compared(bad, message):
    for pair, which in (((bad, layer(PLATE)), "measured"), ((layer(PLATE), bad), "simulated")):
        with pytest.raises(CompareError, match=message) as caught:
            compare(*pair)
        assert which in str(caught.value)
    compare(layer(PLATE), layer(PLATE, x_first_mm=-20.0 + 5e-5))  # the same within 0.1 um


def test_the_dynamic_range_and_the_size_are_checked():
    with pytest.raises(ModelError, match="dynamic_range_db"):
        compare(layer(PLATE), layer(PLATE), dynamic_range_db=0.0)
    small = depth_map(texture(0)[:10, :12])
    with pytest.raises(CompareError, match=r"at least 11 x 11.*got 12 x 10"):
        compare(small, small)


GRID = VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.27, 0.33), 2 * MM)

# Name: centre in mm, radius of the spot in mm, amplitude.
Spot = tuple[tuple[float, float, float], float, float]
SPOTS: Mapping[str, Spot] = {
    "bright": ((-36, 30, 290), 4.0, 1.0),
    "wide": ((30, 24, 300), 11.0, 0.42),
    "low": ((6, -36, 310), 13.0, 0.38),
    "small": ((-40, -40, 300), 5.0, 0.45),
}
OTHERS = ("wide", "low", "small")


def image(*spots: Spot, noise: float = 0.0, seed: int = 0) -> Volume:
    """Smooth spots, as wide in depth as the radar resolves, over white noise."""
    z, y, x = np.meshgrid(GRID.z_m, GRID.y_m, GRID.x_m, indexing="ij")
    data = np.zeros(GRID.shape, dtype=complex)
    for (x_mm, y_mm, z_mm), radius_mm, level in spots:
        across = ((x - x_mm * MM) ** 2 + (y - y_mm * MM) ** 2) / (radius_mm * MM) ** 2
        data += level * np.exp(-across - ((z - z_mm * MM) / 8e-3) ** 2)
    rng = np.random.default_rng(seed)
    data += noise * (rng.normal(size=GRID.shape) + 1j * rng.normal(size=GRID.shape))
    return Volume(data, GRID)


def scene(names: Sequence[str], **changes: Spot) -> Volume:
    return image(*({**SPOTS, **changes}[name] for name in names), noise=0.003)


MEASURED = scene(tuple(SPOTS))


def places_mm(objects: Sequence[Any]) -> list[tuple[int, ...]]:
    return [tuple(round(1e3 * value) for value in one.position_m) for one in objects]


def test_the_brightest_object_is_missing_though_the_overlap_is_good():
    with pytest.warns(ClradarWarning, match="an overlap of 0.8. is misleading here: missing"):
        metrics = compare(MEASURED, scene(OTHERS))
    assert metrics.overlap > 0.8
    (missing,) = metrics.missing
    assert places_mm([missing]) == [(-36, 30, 290)]
    assert missing.level_db == 0.0
    assert missing.weaker_db > 20.0
    # A Gaussian spot has the energy (level^2 - cut^2) radius^2 pi / 2 within its cut.
    cut = 10 ** (-15 / 20)
    energies = {n: (level**2 - cut**2) * radius**2 for n, (_, radius, level) in SPOTS.items()}
    assert missing.share == pytest.approx(energies["bright"] / sum(energies.values()), abs=0.02)
    assert metrics.surplus == ()
    assert metrics.remarks[0] == (
        "missing from the simulation: the brightest object, at (-36, 30, 290) mm with "
        f"{100 * missing.share:.0f} % of the energy"
    )


@pytest.mark.parametrize(
    ("values", "misleading", "remark"),
    [
        ((0.86, 0.56, 0.7, 0.46), True, "0.86, but dB correlation 0.56 and mask IoU 0.46"),
        # A low overlap misleads nobody.
        ((0.32, 0.995, 0.99, 0.91), False, "0.32, but dB correlation 0.99, which does not see "
         "depth; the depth RMSE is 5.0 mm"),
        ((0.9, float("nan"), 0.7, 0.4), False, None),
    ],
)  # fmt: skip
def test_the_metrics_are_said_to_disagree(values, misleading, remark):
    metrics = Metrics(*values, 5e-3, 1e-3, 9e-3)
    assert metrics.misleading == misleading
    expected = () if remark is None else (f"the metrics disagree: overlap {remark}",)
    assert metrics.remarks == expected


@pytest.mark.filterwarnings("ignore:compare. an overlap of:clradar.ClradarWarning")
@pytest.mark.parametrize(
    ("simulated", "missing", "surplus"),
    [
        (("bright", "low"), ["wide", "small"], []),
        (("bright", "wide", "low"), ["small"], []),
        ((*SPOTS, "extra"), [], ["extra"]),
        ((*OTHERS, "extra"), ["bright"], ["extra"]),
    ],
)
def test_objects_of_one_image_alone(simulated, missing, surplus):
    """Also where the surplus is the brightest by far, so that it lowers all others."""
    extra = ((-10.0, 0.0, 290.0), 6.0, 3.0)
    metrics = compare(MEASURED, scene(simulated, extra=extra))
    spots = {**SPOTS, "extra": extra}
    assert sorted(places_mm(metrics.missing)) == sorted(spots[name][0] for name in missing)
    assert places_mm(metrics.surplus) == [spots[name][0] for name in surplus]
    record = json.loads(json.dumps(metrics.to_dict(), allow_nan=False))
    for key, objects in (("missing", metrics.missing), ("surplus", metrics.surplus)):
        assert [one["position_m"] for one in record[key]] == [[*o.position_m] for o in objects]
        assert record[key] == sorted(record[key], key=lambda one: -one["share"])
    assert record["remarks"] == [*metrics.remarks]


def test_an_object_at_another_depth_is_another_object():
    behind = scene(tuple(SPOTS), bright=((-36, 30, 315), 4.0, 1.0))
    found = metrics_of(MEASURED, behind, 15.0)
    assert places_mm(found.missing) == [(-36, 30, 290)]
    assert places_mm(found.surplus) == [(-36, 30, 315)]
    near = scene(tuple(SPOTS), bright=((-36, 30, 290 + 1e3 * NEAR_DEPTH_M - 2), 4.0, 1.0))
    assert metrics_of(MEASURED, near, 15.0).missing == ()


@pytest.mark.parametrize("moved_mm", [(5, 0, 0), (0, 0, 5), (3, 3, 3)])
def test_an_object_that_is_slightly_elsewhere_is_not_missing(moved_mm):
    moved = {
        name: ((x + moved_mm[0], y + moved_mm[1], z + moved_mm[2]), radius, level)
        for name, ((x, y, z), radius, level) in SPOTS.items()
    }
    metrics = compare(MEASURED, scene(tuple(SPOTS), **moved))
    assert (metrics.missing, metrics.surplus) == ((), ())


def test_another_brightness_is_not_missing_until_it_is_weaker_by_the_limit():
    """The gain follows what both show, so one level is off and not all others."""
    for change_db, expected in ((-WEAKER_DB + 2, 0), (-WEAKER_DB - 4, 1)):
        weaker = ((30.0, 24.0, 300.0), 11.0, 0.42 * 10 ** (change_db / 20))
        found = disagreement(*cut_pair("", MEASURED, scene(tuple(SPOTS), wide=weaker), 15.0))
        assert len(found.missing) == expected
        assert found.gain_db == pytest.approx(0.0, abs=0.2)
        assert found.surplus == ()


def test_against_all_pairs_of_pixels():
    """The difference of every pixel, written out, on uneven pixels with unknown depths."""
    rng = np.random.default_rng(3)
    x_m, y_m = (np.cumsum(rng.uniform(1.0, 3.0, n)) * MM for n in (23, 19))
    maps = []
    for _ in range(2):
        depth_m = rng.uniform(0.28, 0.32, (19, 23))
        depth_m[rng.random((19, 23)) < 0.3] = np.nan
        amplitude = 10.0 ** (rng.uniform(-25.0, 0.0, (19, 23)) / 20.0)
        maps.append(DepthMap(depth_m, amplitude, x_m, y_m, 15.0))
    found = disagreement(*cut_pair("", *maps, 15.0))
    cut = [
        np.where(m.amplitude >= m.amplitude.max() * 10 ** (-15 / 20), m.depth_m, np.nan)
        for m in maps
    ]
    relative = [m.amplitude.astype(float) / m.amplitude.max() for m in maps]
    gain = 10 ** (found.gain_db / 20)
    levels = [relative[0], gain * relative[1]]
    x, y = np.meshgrid(x_m, y_m)
    expected = np.where(np.isnan(cut[0]) & np.isnan(cut[1]), np.nan, 0.0)
    for own, other, sign in ((0, 1, 1.0), (1, 0, -1.0)):
        for row, column in zip(*np.nonzero(~np.isnan(cut[own])), strict=True):
            near = np.hypot(x - x[row, column], y - y[row, column]) <= NEAR_M
            near &= ~(np.abs(cut[other] - cut[own][row, column]) > NEAR_DEPTH_M)
            strongest = max(levels[other][near].max(initial=0.0), 1e-9)
            excess = 20 * np.log10(levels[own][row, column] / strongest)
            expected[row, column] += sign * np.clip(excess, 0.0, MOST_DB)
    assert np.abs(expected[~np.isnan(expected)]).max() > 3.0
    np.testing.assert_allclose(found.level_db, expected, atol=1e-9)

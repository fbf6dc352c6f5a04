"""Objects that one image shows and the other lacks, and metrics that contradict each other."""

import json
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from clradar import ClradarWarning, DepthMap, Metrics, Volume, VoxelGrid, compare
from clradar.compare import UnmatchedObject, disagreement
from clradar.compare.unmatched import MOST_DB, NEAR_DEPTH_M, NEAR_M, WEAKER_DB

MM = 1e-3
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


def places_mm(objects: Sequence[UnmatchedObject]) -> list[tuple[int, ...]]:
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


def test_an_object_at_another_depth_is_another_object():
    behind = scene(tuple(SPOTS), bright=((-36, 30, 315), 4.0, 1.0))
    found = disagreement(MEASURED, behind)
    assert places_mm(found.missing) == [(-36, 30, 290)]
    assert places_mm(found.surplus) == [(-36, 30, 315)]
    near = scene(tuple(SPOTS), bright=((-36, 30, 290 + 1e3 * NEAR_DEPTH_M - 2), 4.0, 1.0))
    assert disagreement(MEASURED, near).missing == ()


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
        found = disagreement(MEASURED, scene(tuple(SPOTS), wide=weaker))
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
    found = disagreement(*maps)
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


def test_it_is_part_of_the_record():
    metrics = compare(scene(tuple(SPOTS)), scene(("small",)))
    assert len(metrics.missing) == 3
    record = json.loads(json.dumps(metrics.to_dict(), allow_nan=False))
    assert [one["share"] for one in record["missing"]] == sorted(
        (one.share for one in metrics.missing), reverse=True
    )
    assert record["missing"][0]["position_m"] == list(metrics.missing[0].position_m)
    assert record["surplus"] == []
    assert record["remarks"] == list(metrics.remarks)

"""The kernels as a GPU gets them (one lane per item) against the eight lanes of a CPU."""

from __future__ import annotations

import numpy as np
import pytest

import clradar
from clradar.hand import hand_mesh
from clradar.imaging import fast

# Both widths do the same IEEE operations per lane. Only products that the compiler may fuse with a
# sum differ, by one rounding each: 2^-24 of a term, and at most a few hundred terms in a row.
WIDTH_TOLERANCE = 300 * 2.0**-24


@pytest.fixture(scope="module")
def both() -> list[tuple[clradar.Paths, clradar.Capture, list[clradar.Volume]]]:
    full = clradar.arrays.qar50()
    array = clradar.AntennaArray(full.tx_m[::5], full.rx_m[::7])
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 13)
    scene = clradar.Scene.from_mesh(hand_mesh("F", edge_length_m=3e-3), alpha=0.5)
    grid = clradar.VoxelGrid.from_extent((-0.05, 0.05), (-0.04, 0.04), (0.29, 0.31), 10e-3)
    results = []
    for width in (1, 8):
        device = clradar.open_device("pocl", width=width)
        paths = clradar.trace(scene, array, samples_per_mm2=0.5, max_bounces=2, device=device)
        capture = clradar.synthesize(paths, array, waveform, device=device)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(fast, "FEW_TERMS", 0)  # "fast" is not to become "exact"
            volumes = [
                clradar.backproject(capture, grid, method=method, device=device)
                for method in ("exact", "range", "fast")
            ]
        results.append((paths, capture, volumes))
    return results


def test_same_paths_to_the_bit(both) -> None:
    one, eight = both[0][0], both[1][0]
    assert len(one) > 1000
    for column in ("tx", "rx", "length_m", "amplitude", "bounces"):
        np.testing.assert_array_equal(getattr(one, column), getattr(eight, column))


def test_same_capture_and_images(both) -> None:
    (_, capture_one, volumes_one), (_, capture_eight, volumes_eight) = both
    for one, eight in zip(
        [capture_one, *volumes_one], [capture_eight, *volumes_eight], strict=True
    ):
        error = np.abs(one.data - eight.data).max() / np.abs(eight.data).max()
        assert error <= WIDTH_TOLERANCE

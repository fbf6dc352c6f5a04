"""The kernels as a GPU gets them (one lane per item) against the eight lanes of a CPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

import clradar
from clradar.hand import hand_mesh
from clradar.imaging import block_tree, fast

# Both widths do the same IEEE operations per lane. Only products that the compiler may fuse with a
# sum differ, by one rounding each: 2^-24 of a term, and at most a few hundred terms in a row.
WIDTH_TOLERANCE = 300 * 2.0**-24


class Results(NamedTuple):
    paths: clradar.Paths
    captures: list[clradar.Capture]
    volumes: list[clradar.Volume]


def results_on(device: clradar.Device) -> Results:
    full = clradar.arrays.qar50()
    array = clradar.AntennaArray(full.tx_m[::5], full.rx_m[::7])
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 13)
    mesh = hand_mesh("F", edge_length_m=3e-3)
    scene = clradar.Scene.from_mesh(mesh, alpha=0.5)
    grid = clradar.VoxelGrid.from_extent((-0.05, 0.05), (-0.04, 0.04), (0.29, 0.31), 10e-3)
    fine = clradar.VoxelGrid.from_extent((0.0, 0.02), (0.0, 0.012), (0.29, 0.31), 1e-3)
    paths = clradar.trace(scene, array, samples_per_mm2=0.5, max_bounces=2, device=device)
    capture = clradar.synthesize(paths, array, waveform, device=device)
    expected = clradar.simulate(
        scene, array, waveform, samples_per_mm2=0.05, estimator="expected", device=device
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fast, "FEW_TERMS", 0)  # "fast" is not to become "exact"
        patch.setattr(block_tree, "FEW_KEPT", np.inf)  # nor to sum in all voxels of the fine grid
        volumes = [
            clradar.backproject(capture, grid, method=method, device=device)
            for method in ("exact", "range", "fast")
        ]
        volumes.append(clradar.backproject(capture, fine, check_grid=False, device=device))
    return Results(paths, [capture, expected], volumes)


@pytest.fixture(scope="module")
def one() -> Results:
    return results_on(clradar.open_device("pocl", width=1))


@pytest.fixture(scope="module")
def eight() -> Results:
    return results_on(clradar.open_device("pocl", width=8))


def test_same_paths_to_the_bit(one, eight) -> None:
    assert len(eight.paths) > 1000
    for column in ("tx", "rx", "length_m", "amplitude", "bounces"):
        np.testing.assert_array_equal(getattr(one.paths, column), getattr(eight.paths, column))


def test_same_captures_and_images(one, eight) -> None:
    for a, b in zip([*one.captures, *one.volumes], [*eight.captures, *eight.volumes], strict=True):
        error = np.abs(a.data - b.data).max() / np.abs(b.data).max()
        assert error <= WIDTH_TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("items", [32, 64, 256])
def test_work_groups_change_no_bit(one, items) -> None:
    many = results_on(clradar.open_device("pocl", width=1, group_items=items))
    np.testing.assert_array_equal(many.paths.length_m, one.paths.length_m)
    for a, b in zip([*many.captures, *many.volumes], [*one.captures, *one.volumes], strict=True):
        np.testing.assert_array_equal(a.data, b.data)

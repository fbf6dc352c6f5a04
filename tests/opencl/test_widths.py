"""The kernels as a GPU gets them (one lane per item) against the eight lanes of a CPU."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np
import pytest

import clradar
from clradar.hand import hand_mesh
from clradar.imaging import block_tree, fast
from clradar.opencl.program import launch_parts
from clradar.opencl.sources import kernel_folder

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


def assert_same_bits(some: Results, others: Results) -> None:
    np.testing.assert_array_equal(some.paths.length_m, others.paths.length_m)
    pairs = zip([*some.captures, *some.volumes], [*others.captures, *others.volumes], strict=True)
    for a, b in pairs:
        np.testing.assert_array_equal(a.data, b.data)


def test_launches_in_parts_change_no_bit(one, monkeypatch) -> None:
    n_parts = []

    def recorded(*args):
        n_parts.append(len(launch_parts(*args)))
        return launch_parts(*args)

    monkeypatch.setattr("clradar.opencl.program.launch_parts", recorded)
    assert_same_bits(results_on(clradar.open_device("pocl", width=1, launch_work=3e6)), one)
    assert sum(n > 1 for n in n_parts) > len(n_parts) / 4


@pytest.mark.parametrize("most", [1, 100, 640, 5000, 12345, 10**9])
@pytest.mark.parametrize("size", [(64,), (320, 7), (16, 12, 9), (1, 1, 33)])
def test_parts_have_every_item_once_in_whole_groups(size: tuple[int, ...], most: int) -> None:
    group = (16, 4, 1)[: len(size)] if size[0] > 1 else (1, 1, 1)
    padded = tuple(-(-n // side) * side for n, side in zip(size, group, strict=True))
    launched = np.zeros(padded, int)
    for offset, part in launch_parts(padded, group, most):
        assert math.prod(part) <= max(most, math.prod(group))
        starts = offset or (0,) * len(padded)
        for at, n, side in zip(starts, part, group, strict=True):
            assert at % side == n % side == 0
        launched[tuple(slice(at, at + n) for at, n in zip(starts, part, strict=True))] += 1
    assert (launched == 1).all()


def test_kernels_know_an_item_by_its_global_id_alone() -> None:
    """Else a launch in parts, or in other groups, would give other results."""
    for file in kernel_folder().rglob("*.*"):
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"\bget_(?!global_id\b)\w+\(|\bbarrier\(|__local\b", text), file


@pytest.mark.slow
@pytest.mark.parametrize("items", [32, 64, 256])
def test_work_groups_change_no_bit(one, items) -> None:
    many = results_on(clradar.open_device("pocl", width=1, group_items=items, launch_work=1e7))
    assert_same_bits(many, one)

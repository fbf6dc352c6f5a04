"""Every kernel under the Oclgrind interpreter: bounds, data races, uninitialised reads.

Run with `make memcheck`, which installs Oclgrind in an environment of its own. As a program this
runs every kernel at small odd sizes, or one with a known fault, on the device that CLRADAR_DEVICE
names, and prints the names of those that ran; Oclgrind's reports go to the file OCLGRIND_LOG.
"""

import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pyopencl as cl
import pytest
from core import nearest

import clradar
from clradar.hand import POSES, posed_skeleton
from clradar.hand.flesh import FleshField, grown_flesh
from clradar.imaging import block_tree, fast, tree_on_device, way_down
from clradar.opencl import Buffers, open_device
from clradar.opencl.program import Program
from clradar.opencl.sources import kernel_folder

FAULTS = {
    "invalid write": "out[get_global_id(0) + n] = 1.0f;",
    "race": "out[0] = (float)get_global_id(0);",
    "uninitialized": "float v[4]; v[0] = 1.0f; out[get_global_id(0)] = v[n & 3 | 1];",
}
"""By what is said of each."""


def faulty(kind: str) -> None:
    device = open_device()
    source = f"__kernel void fault(const int n, __global float *out) {{ {FAULTS[kind]} }}"
    kernel = cl.Kernel(cl.Program(device.context, source).build(["-cl-opt-disable"]), "fault")
    with Buffers(device) as buffers:
        out = buffers.empty(32)
        kernel.set_args(np.int32(8), out)
        cl.enqueue_nd_range_kernel(device.queue, kernel, (8,), (1,)).wait()


def everything(width: int) -> None:
    launched = set()
    start = Program.start

    def recorded(self: Program, name: str, *args: Any, **work: float) -> Callable[[], None]:
        launched.add(name)
        return start(self, name, *args, **work)

    Program.start = recorded  # type: ignore[method-assign]
    # Oclgrind's check of uninitialised reads keeps the marks of a freed buffer for the next one at
    # the same address, so nothing is freed here.
    Buffers.close = lambda self, waiting: kept.append(self)  # type: ignore[method-assign]
    Buffers.release = lambda self, buffer: kept.append(buffer)  # type: ignore[method-assign]
    kept: list[object] = []
    # The module, which the function of the same name hides.
    import_module("clradar.phasors.phasor_sum").CALL_PATHS = 64  # type: ignore[attr-defined]
    # As a GPU launches them: in parts.
    device = open_device(width=width, launch_work=1e6 if width == 1 else None)
    full = clradar.arrays.qar50()
    array = clradar.AntennaArray(full.tx_m[::14], full.rx_m[::11])  # 7 x 9: odd against 8 lanes
    waveform = clradar.Waveform([72e9, 75e9, 76e9, 81e9, 82e9])
    # Two panels that face each other across an edge and a floor: bounces, shadows, both sides.
    corners_cm = [[-3, -3, 30], [3, -3, 30], [0, 3, 31], [3, 3, 27], [-3, 3, 33]]
    vertices = 0.01 * np.array([*corners_cm, [0, -3, 26], [0, 0, 26]])
    faces = np.array([[0, 1, 2], [1, 3, 2], [0, 2, 4], [0, 1, 5], [0, 5, 6], [2, 2, 3]])
    scene = clradar.Scene(vertices, faces, alpha=np.array([0.0, 0.5, 1.0, 0.3, 0.7, 0.5]))
    for options in (
        {"max_bounces": 1},
        {"max_bounces": 3, "normals": "face", "seed": 2**40 + 1},
        {"max_bounces": 2, "amplitude": "spreading", "pattern_exponent": 1.5},
        {"rays_per_face": 3, "rays_per_sample": 2},
        {"estimator": "expected"},
        {"estimator": "expected", "amplitude": "spreading", "pattern_exponent": 1.5},
    ):
        if "rays_per_face" not in options:
            options = {**options, "samples_per_mm2": 0.008, "rays_per_sample": 2}
        capture = clradar.simulate(
            scene, array, waveform, reception_radius_m=0.02, device=device, **options
        )
        assert np.abs(capture.data).max() > 0
    # Skeleton antennas also of few points; a rough and a micro-rough dielectric with a pattern.
    import_module("clradar.phasors.kirchhoff_sum").FEW_POINTS = 0  # type: ignore[attr-defined]
    rough = clradar.Material(
        "rough", permittivity=3 - 0.1j, roughness_rms_m=1e-4, correlation_length_m=3e-3,
        micro_roughness_rms_m=1e-4,
    )  # fmt: skip
    shaped = clradar.AntennaArray(
        array.tx_m, array.rx_m, tx_pattern=clradar.AntennaPattern(exponent=1.0)
    )
    # A fifth of the size, so that points share cubes: each costs sums for all pairs.
    middle_m = vertices.mean(axis=0)
    small = clradar.Scene(middle_m + 0.2 * (vertices - middle_m), faces)
    for of, by in ((small, array), (small.with_material(rough), shaped)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # points are sparse
            capture = clradar.simulate(
                of, by, waveform, estimator="physical", samples_per_mm2=0.2, device=device
            )
        assert np.abs(capture.data).max() > 0
    # Two levels of wide nodes, also by rays that are parallel to an axis.
    rng = np.random.default_rng(1)
    soup = rng.uniform(-0.1, 0.1, (101, 1, 3)) + rng.uniform(-0.02, 0.02, (101, 3, 3))
    away = rng.normal(size=(13, 3))
    away[:3] = np.eye(3)
    away /= np.linalg.norm(away, axis=1)[:, None]
    nearest.CACHE_BYTES = 0  # rays are sorted
    with nearest.NearestHits(soup, rng.uniform(-0.1, 0.1, (13, 3)), away, device) as rays:
        rays.trace()
        assert (rays.hits()[1] >= 0).any()
    soup[:, :, 2] += 0.3
    blocky = clradar.Scene(soup.reshape(-1, 3), np.arange(303).reshape(-1, 3), alpha=0.5)
    clradar.trace(blocky, array, rays_per_face=1, reception_radius_m=0.05, device=device)
    corners = vertices[:4] + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.02], [0.01, 0, -0.02]])
    closed = clradar.Scene(corners, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], alpha=0.5)
    clradar.trace(closed, array, rays_per_face=2, reception_radius_m=0.05, device=device)
    one_face = clradar.Scene(vertices[:3], [[0, 1, 2]], alpha=0.5)
    paths = clradar.trace(one_face, array, rays_per_face=7, reception_radius_m=0.05, device=device)
    capture = clradar.synthesize(paths, array, waveform, device=device)
    # Lengths so far apart that blocks have to make room.
    pair = np.arange(150) % 63
    clradar.synthesize(
        clradar.Paths(
            pair // 9, pair % 9, np.linspace(20, 0.3, 150), pair + 0.5, pair % 2 + 1, 7, 9
        ),
        array, waveform, device=device,
    )  # fmt: skip
    clradar.forward(
        capture.array.rx_m, np.ones(9), array, waveform,
        tx_visible=np.ones((9, 7)), device=device,
    )  # fmt: skip
    clradar.ImagingOperator(array, waveform, array.rx_m, device=device).adjoint(capture)
    # "fast" is not to become "exact", nor to leave out levels or interpolation; and phases are made
    # both ways.
    fast.FEW_TERMS, block_tree.FEW_KEPT = 0, np.inf
    block_tree.cheapest = lambda array, waveform, found, summed: len(found)
    shapes = ((-0.001, 0.001), (0.0, 0.0), (-0.004, 0.004))  # 3, 1 and 9 voxels along x
    for shape in shapes if width > 1 else shapes[2:]:
        grid = clradar.VoxelGrid.from_extent(shape, (0, 0.002), (0.30, 0.302), 1e-3)
        for method in ("exact", "range", "fast"):
            clradar.backproject(capture, grid, method=method, device=device)
        # Few blocks are reduced step by step, many in one launch, but on a GPU, which Oclgrind says
        # it is.
        no_gpu = replace(device, info=replace(device.info, kind="accelerator"))
        with (
            mock.patch.object(way_down, "FEWEST_BLOCKS", 0),
            clradar.FrameImager(array, waveform, grid, device=no_gpu) as imager,
        ):
            imager.form(capture)
            imager.depth_map()
        clradar.ImagingOperator(array, waveform, grid, device=device).forward(np.ones(grid.shape))
        tree_on_device.FLOAT32_SHARE = -tree_on_device.FLOAT32_SHARE
    for _ in range(2):
        operator = clradar.ImagingOperator(array, waveform, soup[:4].reshape(-1, 3), device=device)
        operator.adjoint(operator.forward(np.arange(12)))
        tree_on_device.FLOAT32_SHARE = -tree_on_device.FLOAT32_SHARE
    # Points within the cells and beyond them.
    with Buffers(device) as buffers:
        field = FleshField(grown_flesh(posed_skeleton(POSES["F"])), 0.03, buffers)
        assert (field.node_distances_m() < 0).any()
        points_m = rng.uniform(-0.2, 0.3, (13, 3))
        assert np.isfinite(field.distances_m(points_m)).all()
        assert np.isfinite(field.gradients(points_m)).all()
        assert (field.nearest_parts(points_m) < 6).all()
    print(*sorted(launched))


pytestmark = pytest.mark.memcheck

ON_GPUS_ALONE = {"listed_probabilities", "count_probabilities"}
"""Kernels that only the one-lane form has."""


def run_checked(tmp_path: Path, *arguments: str) -> tuple[str, str]:
    """Run the script under Oclgrind; return what it printed and what Oclgrind reported."""
    log = tmp_path / "oclgrind.log"
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[2] / "benchmarks"),
        "CLRADAR_DEVICE": "oclgrind",
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_UNINITIALIZED": "1",
        "OCLGRIND_LOG": str(log),
        # With threads the check of uninitialised reads crashes or reports at random.
        "OCLGRIND_NUM_THREADS": "1",
        "PYOPENCL_NO_CACHE": "1",
    }
    done = subprocess.run(
        [sys.executable, __file__, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, log.read_text() if log.exists() else ""


@pytest.mark.parametrize("width", [1, 8])
def test_no_report_from_any_kernel(tmp_path, width):
    printed, report = run_checked(tmp_path, str(width))
    assert report == ""
    text = "".join(file.read_text() for file in kernel_folder().glob("*.cl"))
    defined = set(re.findall(r"__kernel\s+void\s+(\w+)", text))
    assert set(printed.split()) == (defined if width == 1 else defined - ON_GPUS_ALONE)


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checker_reports_a_known_fault(tmp_path, fault):
    _, report = run_checked(tmp_path, "--faulty", fault)
    assert fault in report.lower()


if __name__ == "__main__":
    if sys.argv[1] == "--faulty":
        faulty(sys.argv[2])
    else:
        everything(int(sys.argv[1]))

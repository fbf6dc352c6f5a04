"""Every work of a device in every way that it may be done: the same bits, or a stated tolerance.

A kernel that is added is tried in all ways by one line of `WORKS`.
"""

import gc
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import cache
from threading import RLock
from typing import Any
from weakref import WeakSet

import numpy as np
import pyopencl as cl
import pytest
from nightly import nightly
from shapes import bowl

import clradar
from clradar import simulation
from clradar.errors import DeviceError
from clradar.hand import hand_mesh
from clradar.imaging import block_tree, fast, tree_on_device, way_down
from clradar.opencl.program import launch_parts
from clradar.opencl.sources import kernel_folder
from clradar.phasors import kirchhoff_sum, phasor_sum
from clradar.tracing import expected, lit_surface, quadrature, stochastic

FULL = clradar.arrays.qar50()
ARRAY = clradar.AntennaArray(FULL.tx_m[::9], FULL.rx_m[::7])  # 11 x 14: odd against 8 lanes
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 13)
SCENE = clradar.Scene(*bowl(), 0.5)
ROUGH = clradar.Material(
    "rough", permittivity=6.5 - 8.9j, roughness_rms_m=0.05e-3, correlation_length_m=1e-3
)
COARSE = clradar.VoxelGrid.from_extent((-0.05, 0.05), (-0.04, 0.04), (0.29, 0.31), 10e-3)
FINE = clradar.VoxelGrid.from_extent((0.0, 0.02), (0.0, 0.012), (0.29, 0.31), 1e-3)
RNG = np.random.default_rng(1)
NOISE = clradar.Capture(RNG.normal(size=(11, 14, 13, 2)).view(complex)[..., 0], ARRAY, WAVEFORM)
POINTS_M = RNG.uniform([-0.02, -0.02, 0.28], [0.02, 0.02, 0.3], (500, 3))
VALUES = RNG.normal(size=(500, 2)).view(complex)[:, 0].astype(np.complex64)

pytestmark = pytest.mark.filterwarnings("ignore::clradar.ClradarWarning")

Work = Callable[[clradar.Device], list[np.ndarray]]


def traced(device: clradar.Device) -> clradar.Paths:
    return clradar.trace(SCENE, ARRAY, samples_per_mm2=0.05, max_bounces=2, device=device)


def simulated(estimator: str, scene: clradar.Scene = SCENE, **settings: Any) -> Work:
    fields = {"estimator": estimator, **settings}
    return lambda device: [clradar.simulate(scene, ARRAY, WAVEFORM, device=device, **fields).data]


def of_alphas(device: clradar.Device) -> list[np.ndarray]:
    fields = {"samples_per_mm2": 0.05, "rays_per_sample": 4, "device": device}
    made = simulation.simulate_alphas(SCENE, ARRAY, WAVEFORM, [0.0, 0.3, 1.0], **fields)
    return [capture.data for (capture,) in made]


def imaged(grid: clradar.VoxelGrid, method: str) -> Work:
    options: dict[str, Any] = {"method": method, "check_grid": False}
    return lambda device: [clradar.backproject(NOISE, grid, device=device, **options).data]


def framed(device: clradar.Device) -> list[np.ndarray]:
    """Two frames and their depth maps, and a simulation that is imaged where it is."""
    made = []
    with clradar.FrameImager(ARRAY, WAVEFORM, FINE, device=device) as imager:
        for data in (NOISE.data, 2j * NOISE.data):
            imager.form(clradar.Capture(data, ARRAY, WAVEFORM))
            made += [imager.volume().data, imager.depth_map(20.0).amplitude]
        clradar.simulate_image(SCENE, imager, estimator="expected", samples_per_mm2=0.05)
        return [*made, imager.volume().data]


def operated(device: clradar.Device) -> list[np.ndarray]:
    """Both directions, of points and of voxels."""
    cloud, voxels = (
        clradar.ImagingOperator(ARRAY, WAVEFORM, where, device=device) for where in (POINTS_M, FINE)
    )
    samples = cloud.forward(VALUES)
    image = voxels.adjoint(samples)
    return [samples, cloud.adjoint(samples), image, voxels.forward(image / np.abs(image).max())]


WORKS: dict[str, Work] = {
    "trace": lambda device: [
        getattr(traced(device), name) for name in ("tx", "rx", "length_m", "amplitude", "bounces")
    ],
    "synthesize": lambda device: [
        clradar.synthesize(given_paths(), ARRAY, WAVEFORM, device=device).data
    ],
    "stochastic": simulated("stochastic", samples_per_mm2=0.05, max_bounces=2),
    "alphas": of_alphas,
    "expected": simulated("expected", samples_per_mm2=0.05),
    "physical": simulated("physical", SCENE.with_material("metal"), samples_per_mm2=0.15),
    "rough": simulated("physical", SCENE.with_material(ROUGH), samples_per_mm2=0.15),
    "exact": imaged(COARSE, "exact"),
    "range": imaged(COARSE, "range"),
    "fast": imaged(COARSE, "fast"),
    "fast, fine": imaged(FINE, "fast"),
    "frames": framed,
    "operator": operated,
    "hand": lambda device: [hand_mesh("S", 4e-3, device=device).vertices_m],
}
"""What a device computes, and what of it is compared."""


@cache
def given_paths() -> clradar.Paths:
    return traced(clradar.open_device("pocl"))


# Both widths do the same IEEE operations per lane. Only products that the compiler may fuse with
# a sum differ, by one rounding each: 2^-24 of a term, and at most a few hundred terms in a row. In
# the expected estimator roundings decide where a horizon cuts a disc, magnified by up to 1/0.03.
WIDTH_TOLERANCE = {"trace": 0.0, "hand": 0.0, "expected": 1e-4, "frames": 1e-4}
OTHER_TOLERANCE = 300 * 2.0**-24

MEMORY_BYTES = {
    **{"trace": 500_000, "synthesize": 60_000, "stochastic": 300_000, "expected": 500_000},
    "alphas": 550_000,
    **{"physical": 1_500_000, "rough": 1_500_000, "exact": 60_000, "range": 120_000},
    **{"fast": 400_000, "fast, fine": 600_000, "frames": 8_000_000, "operator": 4_000_000},
    "hand": 200_000,
}
"""Little for each: below it a buffer that nothing can divide does not fit."""


def of_gpu(items: int, **options: Any) -> Callable[..., Any]:
    """PoCL that says it is a GPU: the host's other branches, with the tree built beside it."""

    @cache
    def gpu() -> clradar.Device:
        cpu = clradar.open_device("pocl", width=1, **options)
        own = {"programs": {}, "buffers": WeakSet(), "lock": RLock()}
        return replace(cpu, info=replace(cpu.info, kind="gpu"), group_items=items, **own)

    return lambda work: nullcontext(gpu())


def of_little_memory(width: int | None) -> Callable[..., Any]:
    """With the programs that are built already."""

    def opened(work: str) -> Any:
        device = clradar.open_device("pocl", width=width)
        return nullcontext(replace(device, budget_bytes=MEMORY_BYTES[work], buffers=WeakSet()))

    return opened


def of_pieces(*constants: tuple[Any, str, Any]) -> Callable[..., Any]:
    @contextmanager
    def patched(work: str) -> Iterator[clradar.Device]:
        with pytest.MonkeyPatch.context() as patch:
            for module, name, value in constants:
                patch.setattr(module, name, value)
            yield clradar.open_device("pocl")

    return patched


WAYS: dict[str, Callable[..., Any]] = {
    "little memory": of_little_memory(None),
    "small pieces": of_pieces(
        (lit_surface, "TILE_SAMPLES", 64), (stochastic, "TILE_SAMPLES", 64),
        (expected, "TILE_SAMPLES", 64), (expected, "BATCH_SAMPLES", 13),
        (stochastic, "MOST_LISTED", 100), (stochastic, "MOST_ORDINAL", 200_000),
        (phasor_sum, "CALL_PATHS", 64),
        (quadrature, "TILE_POINTS", 1001), (kirchhoff_sum, "LEG_BYTES", 2**17),
        (kirchhoff_sum, "BATCH_BYTES", 2**17), (tree_on_device, "CPU_CHUNK_BYTES", 1),
        (way_down, "FEWEST_BLOCKS", 1),
    ),
    "blocks of Tx": of_pieces(
        (simulation, "SUM_BYTES", 1), (kirchhoff_sum, "CAPTURE_SHARE", 1e-5)
    ),
    # The buffer of receptions grows, and tiles are halved, also after some alphas are done.
    "few receptions": of_pieces(
        (stochastic.Tracer, "_most_receptions", lambda self: 100 if self._capacity else 1)
    ),
    "a GPU": of_gpu(1),
    "a GPU, groups of 32": of_gpu(32, launch_work=3e5),
    "a GPU, groups of 256": of_gpu(256, launch_work=1e6),
    "one lane": lambda work: nullcontext(clradar.open_device("pocl", width=1)),
    "one lane, little memory": of_little_memory(1),
}  # fmt: skip


@pytest.fixture(autouse=True)
def always_a_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fast, "FEW_TERMS", 0)  # "fast" is not to become "exact"
    monkeypatch.setattr(block_tree, "FEW_KEPT", np.inf)  # nor to sum in all voxels of a fine grid


@pytest.fixture(autouse=True)
def n_parts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Of each launch."""
    found: list[int] = []

    def recorded(*args: Any) -> Any:
        parts = launch_parts(*args)
        found.append(len(parts))
        return parts

    monkeypatch.setattr("clradar.opencl.program.launch_parts", recorded)
    return found


@cache
def made(work: str, way: str | None = None) -> list[np.ndarray]:
    if way is None:
        return WORKS[work](clradar.open_device("pocl"))
    with WAYS[way](work) as device:
        return WORKS[work](device)


def largest_error(found: list[np.ndarray], wanted: list[np.ndarray]) -> float:
    return max(
        float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(found, wanted, strict=True)
    )


SIMULATIONS = ("stochastic", "expected", "physical", "rough", "frames")
NOT_DIVIDED = ("exact", "range", "hand")
"""Of which no constant of "small pieces" is."""


def matters(work: str, way: str) -> bool:
    if way == "blocks of Tx":
        return work in SIMULATIONS
    if way == "few receptions":
        return work in ("trace", "stochastic", "alphas")
    return way != "small pieces" or work not in NOT_DIVIDED


OFTEN_FAILING = ("stochastic", "rough", "fast")
"""Of which a device of little memory is made to fail in every run: of rays, points, images."""

OFTEN = {
    "little memory": ("synthesize", "expected", "alphas", "range"),  # and those made to fail
    "small pieces": ("synthesize", "expected", "rough", "fast", "operator"),
    "blocks of Tx": ("expected", "rough"),
    "few receptions": ("alphas",),
    "a GPU": ("trace", "synthesize", "rough", "exact", "range", "fast", "operator"),
    "a GPU, groups of 32": ("synthesize",),
}
"""What every run does of each way. PoCL compiles each kernel for each size of groups and set of
options, a third of a second every time; one lane of "expected" is in test_expected.py."""

PAIRS = [(work, way) for work in WORKS for way in WAYS if matters(work, way)]
RARELY = [(work, way) for work, way in PAIRS if work not in OFTEN.get(way, ())]


@pytest.mark.parametrize(("work", "way"), [p for p in PAIRS if p not in RARELY] + nightly(RARELY))
def test_no_way_changes_a_result(work, way, n_parts):
    found = made(work, way)
    assert (max(n_parts) > 1) == ("groups" in way)  # that is where launches are divided
    assert all(np.abs(a).max() > 0 for a in found)
    if way in ("little memory", "small pieces", "blocks of Tx", "few receptions"):
        assert largest_error(found, made(work)) == 0
        return
    assert largest_error(found, made(work)) <= WIDTH_TOLERANCE.get(work, OTHER_TOLERANCE)
    assert largest_error(found, made(work, "a GPU")) == 0


@pytest.mark.parametrize(
    "work",
    [*OFTEN_FAILING, *nightly(work for work in WORKS if work not in OFTEN_FAILING)],
)
def test_after_a_device_failed_in_the_middle_all_is_free_and_the_next_call_works(work, monkeypatch):
    whole = made(work)
    with WAYS["little memory"](work) as device:
        used, left = device.used_bytes, math.inf
        enqueue = cl.enqueue_nd_range_kernel

        def launched(*args: Any, **kwargs: Any) -> Any:
            nonlocal left
            left -= 1
            if left < 0:
                raise cl.RuntimeError("enqueue_nd_range_kernel failed: OUT_OF_RESOURCES")
            return enqueue(*args, **kwargs)

        monkeypatch.setattr(cl, "enqueue_nd_range_kernel", launched)
        left = 10**9
        WORKS[work](device)
        launches = 10**9 - left
        for before in {launches // 2, launches - 1}:
            left = before
            with pytest.raises(DeviceError, match=r"^device .*OUT_OF_RESOURCES"):
                WORKS[work](device)
            gc.collect()
            assert device.used_bytes == used
        left = math.inf
        assert largest_error(WORKS[work](device), whole) == 0


def test_kernels_know_an_item_by_its_global_id_alone():
    """Else a launch in parts, or in other groups, would give other results."""
    for file in kernel_folder().rglob("*.*"):
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"\bget_(?!global_id\b)\w+\(|\bbarrier\(|__local\b", text), file

"""Pieces of work, each timed against what a user has already, in the same run, and checked.

Left out of the timings: imports, the first call of everything that compiles, and what a row says is
given.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import clradar
from clradar.bench import peers
from clradar.formers.range_profiles import Range

C_M_PER_S = 299_792_458.0
ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)
PAPER = {"x_m": (-0.1, 0.1), "y_m": (-0.1, 0.1), "z_m": (0.26, 0.34)}


Row = dict[str, Any]
"""work, ours, peer and check in words; ratio, the peer's time over ours, or None."""


def median_s(work: Callable[[], Any], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def relative_rms_db(ours: np.ndarray, theirs: np.ndarray) -> float:
    error = np.sqrt(np.mean(np.abs(ours - theirs) ** 2) / np.mean(np.abs(theirs) ** 2))
    return float(20 * np.log10(error))


def interleaved_s(
    works: Sequence[Callable[[], Any]], repeats: int, pause_s: float = 0.0
) -> np.ndarray:
    """Seconds of each work in turn, shape (repeats, n_works): other load meets all alike.

    With a pause before each, for what leaves threads behind that wait actively for a while.
    """
    for work in works:
        work()
    times = np.empty((repeats, len(works)))
    for row in times:
        for i, work in enumerate(works):
            time.sleep(pause_s)
            start = time.perf_counter()
            work()
            row[i] = time.perf_counter() - start
    return times


def phasor_sum(device: clradar.Device, repeats: int, n_paths: int) -> list[Row]:
    """Equal steps against finufft, and unequal steps against our own equal ones."""
    rng = np.random.default_rng(0)
    pair = np.sort(rng.integers(0, ARRAY.n_tx * ARRAY.n_rx, n_paths))
    length = rng.uniform(0.5, 0.8, n_paths)
    paths = clradar.Paths(
        pair // ARRAY.n_rx, pair % ARRAY.n_rx, length, np.ones(n_paths), np.ones(n_paths),
        ARRAY.n_tx, ARRAY.n_rx,
    )  # fmt: skip
    start = np.searchsorted(pair, np.arange(ARRAY.n_tx * ARRAY.n_rx + 1))
    f = WAVEFORM.frequencies_hz
    inner = np.sort(rng.uniform(f[0], f[-1], len(f) - 2))
    unequal = clradar.Waveform(np.concatenate([f[:1], inner, f[-1:]]))
    peer = peers.FinufftPhasorSum(start, f, 1e-5)

    def ours(waveform: clradar.Waveform = WAVEFORM) -> np.ndarray:
        data = clradar.synthesize(paths, ARRAY, waveform, device=device).data
        return data.reshape(-1, waveform.n_freq)

    def prepare() -> None:
        peer.prepare(paths.length_m, paths.amplitude)

    def error_db(data: np.ndarray, waveform: clradar.Waveform) -> float:
        """Against float64, for a few of the pairs."""
        some = range(0, len(start) - 1, 400)
        k = waveform.frequencies_hz / C_M_PER_S
        rows = (length[start[i] : start[i + 1]] for i in some)
        want = np.array([np.exp(-2j * np.pi * np.outer(d, k)).sum(axis=0) for d in rows])
        return relative_rms_db(data[some], want)

    works: list[Callable[[], Any]] = [ours, prepare, peer.transform, lambda: ours(unequal)]
    ours_s, prepare_s, transform_s, unequal_s = interleaved_s(works, repeats).T
    ratios = (prepare_s + transform_s) / ours_s
    spread = f"ratios {ratios.min():.1f} to {ratios.max():.1f}"
    alone = float(np.median(transform_s / ours_s))
    size = f"{n_paths / 1e6:g} M paths, {len(start) - 1} pairs x {len(f)}"
    ours_db, peer_db = error_db(ours(), WAVEFORM), error_db(peer.transform(), WAVEFORM)
    unequal_db = error_db(ours(unequal), unequal)
    return [
        {
            "work": f"phasor sum, {size}",
            "ours": f"{np.median(ours_s):.3f} s",
            "peer": f"finufft type 1, 1e-5, two threads, {np.median(transform_s):.3f} s, and "
            f"{np.median(prepare_s):.3f} s of numba for its points and strengths",
            "ratio": float(np.median(ratios)),
            "check": f"{spread}, {alone:.1f} without the preparation; against float64 ours "
            f"{ours_db:.0f} dB, the peer's {peer_db:.0f} dB",
        },
        {
            "work": f"phasor sum, {size} unequal steps",
            "ours": f"{np.median(unequal_s):.3f} s",
            "peer": "ours with equal steps",
            "ratio": float(np.median(ours_s / unequal_s)),
            "check": f"{unequal_db:.0f} dB against float64",
        },
    ]


def images(
    device: clradar.Device, repeats: int, capture: clradar.Capture, planes: int
) -> list[Row]:
    """By range and by fast, against the same peer."""
    spacing = (1e-3, 1e-3, 0.08 / (planes - 1))
    grid = clradar.VoxelGrid.from_extent(**PAPER, spacing_m=spacing)
    former = Range(capture, grid, np.ones(WAVEFORM.n_freq), device)
    tile = next(iter(former.tiles()))
    first, stop = former._bins(tile)
    d_m = np.arange(first, stop) / float(former.bins_per_m)
    f = WAVEFORM.frequencies_hz
    k = WAVEFORM.center_hz / C_M_PER_S
    kernel = np.exp(2j * np.pi * np.outer(f / C_M_PER_S - k, d_m)).astype(np.complex64)
    profiles = (capture.data.reshape(-1, len(f)) @ kernel / len(f)).reshape(94, 94, -1)

    def ours() -> np.ndarray:
        return clradar.backproject(capture, grid, method="range", device=device).data

    def theirs() -> np.ndarray:
        return peers.range_backprojection(
            profiles, float(d_m[0]), float(former.bins_per_m), k, ARRAY.tx_m, ARRAY.rx_m,
            grid.x_m, grid.y_m, grid.z_m,
        )  # fmt: skip

    def fast() -> np.ndarray:
        return clradar.backproject(capture, grid, device=device).data

    image = ours()
    error, fast_error = relative_rms_db(theirs(), image), relative_rms_db(fast(), image)
    ours_s, fast_s = median_s(ours, repeats), median_s(fast, repeats)
    theirs_s = median_s(theirs, max(1, repeats // 2))
    work = np.prod(grid.shape) * 8836
    peer = f"numba, two threads, blocked, {work / theirs_s / 1e6:.0f} M/s (profiles given)"
    return [
        {
            "work": f"image by range, 201 x 201 x {planes}",
            "ours": f"{ours_s:.1f} s, {work / ours_s / 1e6:.0f} M voxel pairs/s",
            "peer": peer,
            "ratio": theirs_s / ours_s,
            "check": f"{error:.0f} dB between the two",
        },
        {
            "work": f"image by fast, 201 x 201 x {planes}, -50 dB asked for",
            "ours": f"{fast_s:.2f} s",
            "peer": peer,
            "ratio": theirs_s / fast_s,
            "check": f"{fast_error:.0f} dB to the image by range",
        },
    ]


def exact_image(device: clradar.Device, repeats: int, capture: clradar.Capture) -> Row:
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.05, 0.05), (0.3, 0.3), 2e-3)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)

    def ours() -> np.ndarray:
        return clradar.backproject(capture, grid, method="exact", device=device).data.ravel()

    def theirs() -> np.ndarray:
        return peers.exact_by_gemm(capture, points)

    error = relative_rms_db(ours(), theirs())
    ours_s, theirs_s = median_s(ours, repeats), median_s(theirs, repeats)
    terms = len(points) * capture.data.size
    return {
        "work": f"exact sum, {terms / 1e9:.1f} G terms",
        "ours": f"{terms / ours_s / 1e9:.1f} G terms/s",
        "peer": f"numpy, complex GEMM per frequency, {terms / theirs_s / 1e9:.1f} G/s",
        "ratio": theirs_s / ours_s,
        "check": f"{error:.0f} dB between the two",
    }


PEAK_MEMORY = """
import sys
from clradar.cli import main
try:
    main()
finally:
    status = open("/proc/self/status").read()
    print("peak kB:", status.split("VmHWM:")[1].split()[0], file=sys.stderr)
"""
"""Runs the command line and says the process's peak of resident memory, by the operating system."""


def commands(device: clradar.Device) -> list[Row]:
    """The two commands whose time and memory are promised, as a user runs them."""
    runs = []
    with tempfile.TemporaryDirectory() as folder:
        hand, sim, volume = (str(Path(folder) / name) for name in ("hand.ply", "sim.h5", "vol.h5"))
        cli = [sys.executable, "-c", PEAK_MEMORY]
        chosen = ["--device", device.info.selector]
        subprocess.run([*cli, "hand", "F", "-o", hand], check=True, capture_output=True)
        for name, arguments in (
            ("simulate the default hand", ["simulate", hand, "-o", sim, *chosen]),
            ("image, 201 x 201 x 81", ["image", sim, "-o", volume, *chosen]),
        ):
            start = time.perf_counter()
            done = subprocess.run([*cli, *arguments], check=True, capture_output=True, text=True)
            seconds = time.perf_counter() - start
            peak_kb = int(done.stderr.split("peak kB:")[1].split()[0])
            runs.append(
                {
                    "work": f"clradar {name}",
                    "ours": f"{seconds:.1f} s, {peak_kb / 1e6:.2f} GB",
                    "peer": "",
                    "ratio": None,
                    "check": "",
                }
            )
    return runs

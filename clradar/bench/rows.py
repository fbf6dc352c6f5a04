"""Phasor sum, images and commands, timed alternately with independent implementations and checked.

Not in the timings: imports, the first call of everything that compiles, and what a row names as
given.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import clradar
from clradar.bench import peers
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.block_tree import block_levels
from clradar.imaging.range_profiles import RangeImager

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 128)
PAPER = {"x_m": (-0.1, 0.1), "y_m": (-0.1, 0.1), "z_m": (0.26, 0.34)}


@dataclass(frozen=True, slots=True)
class Row:
    """Timings of one piece of work in words; `ratio`: the peer's time over ours."""

    work: str
    ours: str
    peer: str = ""
    ratio: float | None = None
    check: str = ""


def relative_rms_db(ours: np.ndarray, theirs: np.ndarray) -> float:
    error = np.sqrt(np.mean(np.abs(ours - theirs) ** 2) / np.mean(np.abs(theirs) ** 2))
    return float(20 * np.log10(error))


def interleaved_s(
    works: Sequence[Callable[[], Any]], repeats: int, pause_s: float = 0.0
) -> np.ndarray:
    """Seconds of each work, shape (repeats, n_works), alternately: other load affects all alike.

    A pause before each lets threads of the one before end their busy waiting.
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


class PathSums:
    """Paths spread evenly over all pairs, for sums at equal and at unequal frequency steps."""

    def __init__(self, device: clradar.Device, n_paths: int) -> None:
        rng = np.random.default_rng(0)
        pair = np.sort(rng.integers(0, ARRAY.n_tx * ARRAY.n_rx, n_paths))
        length = rng.uniform(0.5, 0.8, n_paths)
        self.paths = clradar.Paths(
            pair // ARRAY.n_rx, pair % ARRAY.n_rx, length, np.ones(n_paths), np.ones(n_paths),
            ARRAY.n_tx, ARRAY.n_rx,
        )  # fmt: skip
        self.start = np.searchsorted(pair, np.arange(ARRAY.n_tx * ARRAY.n_rx + 1))
        f = WAVEFORM.frequencies_hz
        inner = np.sort(rng.uniform(f[0], f[-1], len(f) - 2))
        self.unequal = clradar.Waveform(np.concatenate([f[:1], inner, f[-1:]]))
        self.peer = peers.FinufftPhasorSum(self.start, f, 1e-5)
        self.device = device

    def ours(self, waveform: clradar.Waveform = WAVEFORM) -> np.ndarray:
        data = clradar.synthesize(self.paths, ARRAY, waveform, device=self.device).data
        return data.reshape(-1, waveform.n_freq)

    def prepare(self) -> None:
        """Make the peer's points and strengths."""
        self.peer.prepare(self.paths.length_m, self.paths.amplitude)

    def error_db(self, data: np.ndarray, waveform: clradar.Waveform = WAVEFORM) -> float:
        """Against float64, for a few of the pairs."""
        some = range(0, len(self.start) - 1, 400)
        k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        rows = (self.paths.length_m[self.start[i] : self.start[i + 1]] for i in some)
        want = np.array([np.exp(-2j * np.pi * np.outer(d, k)).sum(axis=0) for d in rows])
        return relative_rms_db(data[some], want)


def phasor_sum(device: clradar.Device, repeats: int, n_paths: int) -> list[Row]:
    """Equal steps against finufft, and unequal steps against our own equal ones."""
    work = PathSums(device, n_paths)
    unequal = partial(work.ours, work.unequal)
    two = partial(work.peer.transform, 2)
    works: list[Callable[[], Any]] = [work.ours, work.prepare, work.peer.transform, two, unequal]
    ours_s, prepare_s, *transforms_s, unequal_s = interleaved_s(works, repeats).T
    transform_s = min(transforms_s, key=np.median)
    one_s, two_s = (np.median(s) for s in transforms_s)
    ratios = (prepare_s + transform_s) / ours_s
    spread = f"ratios {ratios.min():.1f} to {ratios.max():.1f}"
    alone = float(np.median(transform_s / ours_s))
    size = f"{n_paths / 1e6:g} M paths, {len(work.start) - 1} pairs x {WAVEFORM.n_freq}"
    ours_db, peer_db = work.error_db(work.ours()), work.error_db(work.peer.transform())
    unequal_db = work.error_db(unequal(), work.unequal)
    return [
        Row(
            work=f"phasor sum, {size}",
            ours=f"{np.median(ours_s):.3f} s",
            peer=f"the faster of: finufft type 1, 1e-5, one thread {one_s:.3f} s, two "
            f"{two_s:.3f} s; and numba, {np.median(prepare_s):.3f} s for its points and strengths",
            ratio=float(np.median(ratios)),
            check=f"{spread}, {alone:.1f} without the preparation; against float64 ours "
            f"{ours_db:.0f} dB, the peer's {peer_db:.0f} dB",
        ),
        Row(
            work=f"phasor sum, {size} unequal steps",
            ours=f"{np.median(unequal_s):.3f} s",
            peer="ours with equal steps",
            ratio=float(np.median(ours_s / unequal_s)),
            check=f"{unequal_db:.0f} dB against float64",
        ),
    ]


class PaperVolume:
    """The paper's volume with some of its planes, of one capture, and the peer's profiles of it."""

    def __init__(self, device: clradar.Device, capture: clradar.Capture, planes: int) -> None:
        spacing = (1e-3, 1e-3, 0.08 / (planes - 1))
        self.device, self.capture = device, capture
        self.grid = clradar.VoxelGrid.from_extent(**PAPER, spacing_m=spacing)
        imager = RangeImager(capture, self.grid, np.ones(WAVEFORM.n_freq), device)
        first, stop = imager.bins(next(iter(imager.tiles())))
        self.bins_per_m = float(imager.bins_per_m)
        d_m = np.arange(first, stop) / self.bins_per_m
        self.first_m = float(d_m[0])
        f = WAVEFORM.frequencies_hz
        self.k = WAVEFORM.center_hz / SPEED_OF_LIGHT_M_PER_S
        kernel = np.exp(2j * np.pi * np.outer(f / SPEED_OF_LIGHT_M_PER_S - self.k, d_m)).astype(
            np.complex64
        )
        self.profiles = (capture.data.reshape(-1, len(f)) @ kernel / len(f)).reshape(94, 94, -1)

    @property
    def voxel_pairs(self) -> int:
        return int(np.prod(self.grid.shape)) * ARRAY.n_tx * ARRAY.n_rx

    def ours(self, method: str) -> np.ndarray:
        return clradar.backproject(self.capture, self.grid, method=method, device=self.device).data

    def theirs(self) -> np.ndarray:
        return peers.range_backprojection(
            self.profiles, self.first_m, self.bins_per_m, self.k, ARRAY.tx_m, ARRAY.rx_m,
            self.grid.x_m, self.grid.y_m, self.grid.z_m,
        )  # fmt: skip


def images(
    device: clradar.Device, repeats: int, capture: clradar.Capture, planes: int
) -> list[Row]:
    """By range and by fast, against the same peer.

    The first image by fast chooses antennas and frequencies, the next has them already.
    """
    image = PaperVolume(device, capture, planes)
    ours, fast = partial(image.ours, "range"), partial(image.ours, "fast")

    def fast_anew() -> np.ndarray:
        block_levels.cache_clear()
        return fast()

    by_range = ours()
    error = relative_rms_db(image.theirs(), by_range)
    fast_error = relative_rms_db(fast(), by_range)
    times_s = interleaved_s([ours, fast_anew, fast, image.theirs], repeats)
    ours_s, fast_s, again_s, theirs_s = np.median(times_s, axis=0)
    ratio, fast_ratio, again_ratio = np.median(times_s[:, 3:] / times_s[:, :3], axis=0)
    work = image.voxel_pairs
    peer = f"numba, two threads, blocked, {work / theirs_s / 1e6:.0f} M/s (profiles given)"
    return [
        Row(
            work=f"image by range, 201 x 201 x {planes}",
            ours=f"{ours_s:.1f} s, {work / ours_s / 1e6:.0f} M voxel pairs/s",
            peer=peer,
            ratio=float(ratio),
            check=f"{error:.0f} dB between the two",
        ),
        Row(
            work=f"image by fast, 201 x 201 x {planes}, -50 dB requested",
            ours=f"{fast_s:.2f} s, and {again_s:.2f} s for the next of the same array and grid",
            peer=peer,
            ratio=float(fast_ratio),
            check=f"{again_ratio:.1f} x for the next; {fast_error:.0f} dB to the image by range",
        ),
    ]


class ExactImage:
    """A plane of voxels by the sum as it stands, and the peer's."""

    def __init__(self, device: clradar.Device, capture: clradar.Capture) -> None:
        self.device, self.capture = device, capture
        self.grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.05, 0.05), (0.3, 0.3), 2e-3)
        z, y, x = np.meshgrid(self.grid.z_m, self.grid.y_m, self.grid.x_m, indexing="ij")
        self.points_m = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)

    @property
    def terms(self) -> int:
        return len(self.points_m) * self.capture.data.size

    def ours(self) -> np.ndarray:
        return clradar.backproject(
            self.capture, self.grid, method="exact", device=self.device
        ).data.ravel()

    def theirs(self) -> np.ndarray:
        return peers.exact_by_gemm(self.capture, self.points_m)


def exact_image(device: clradar.Device, repeats: int, capture: clradar.Capture) -> Row:
    image = ExactImage(device, capture)
    error = relative_rms_db(image.ours(), image.theirs())
    times_s = interleaved_s([image.ours, image.theirs], repeats)
    ours_s, theirs_s = np.median(times_s, axis=0)
    return Row(
        work=f"exact sum, {image.terms / 1e9:.1f} G terms",
        ours=f"{image.terms / ours_s / 1e9:.1f} G terms/s",
        peer=f"numpy, complex GEMM per frequency, {image.terms / theirs_s / 1e9:.1f} G/s",
        ratio=float(np.median(times_s[:, 1] / times_s[:, 0])),
        check=f"{error:.0f} dB between the two",
    )


PEAK_MEMORY = """
import sys
from clradar.cli import main
try:
    main()
finally:
    status = open("/proc/self/status").read()
    print("peak kB:", status.split("VmHWM:")[1].split()[0], file=sys.stderr)
"""
"""Runs the command line and prints the peak resident memory of its process."""


def commands(device: clradar.Device) -> list[Row]:
    """The two commands whose time and memory are documented, as a user runs them."""
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
            runs.append(Row(f"clradar {name}", ours=f"{seconds:.1f} s, {peak_kb / 1e6:.2f} GB"))
    return runs

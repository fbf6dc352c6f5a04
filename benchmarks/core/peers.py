"""Independent implementations of the same work, each at its best."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import finufft
import numba
import numpy as np
from threadpoolctl import threadpool_limits

from clradar.constants import SPEED_OF_LIGHT_M_PER_S


class FinufftPhasorSum:
    """SFCW sum of paths sorted by pair, equal steps, by finufft's type 1.

    The fastest way to use finufft at its accuracy: a plan per thread, which takes the points of one
    pair after the other and does not sort them (docs/performance.md).
    """

    def __init__(self, start: np.ndarray, frequencies_hz: np.ndarray, eps: float) -> None:
        self.start, self.eps, self.n_freq = start, eps, len(frequencies_hz)
        k = frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        # Mode 0 is the frequency in the middle; its phasor goes into the strengths.
        self.k, self.dk = k[self.n_freq // 2], (k[-1] - k[0]) / (self.n_freq - 1)

    def prepare(self, length_m: np.ndarray, amplitude: np.ndarray) -> None:
        """Points and strengths, complex64."""
        turns, steps = self.k * length_m, self.dk * length_m
        phasor = np.exp(-2j * np.pi * (turns - np.rint(turns)))
        self.strength = (amplitude * phasor).astype(np.complex64)
        self.point = (2 * np.pi * (steps - np.rint(steps))).astype(np.float32)

    def transform(self, threads: int = 1) -> np.ndarray:
        """Shape (n_pairs, n_freq), complex64."""
        n_pairs = len(self.start) - 1
        out = np.zeros((n_pairs, self.n_freq), dtype=np.complex64)

        def some(pairs: range) -> None:
            plan = finufft.Plan(
                1, (self.n_freq,), 1, self.eps, -1, dtype="complex64", nthreads=1, spread_sort=0
            )
            for pair in pairs:
                rows = slice(self.start[pair], self.start[pair + 1])
                if rows.stop > rows.start:
                    plan.setpts(self.point[rows])
                    plan.execute(self.strength[rows], out=out[pair])

        bounds = [n_pairs * i // threads for i in range(threads + 1)]
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(some, map(range, bounds[:-1], bounds[1:])))
        return out


@numba.njit(parallel=True, fastmath=True, cache=False)
def range_backprojection(
    profiles: np.ndarray,
    first_m: float,
    bins_per_m: float,
    k: float,
    tx_m: np.ndarray,
    rx_m: np.ndarray,
    x_m: np.ndarray,
    y_m: np.ndarray,
    z_m: np.ndarray,
) -> np.ndarray:
    """Back-projection from range profiles, one row of voxels per block to stay in the cache."""
    n_tx, n_rx, _ = profiles.shape
    nx, ny, nz = len(x_m), len(y_m), len(z_m)
    out = np.zeros((nz, ny, nx), dtype=np.complex64)
    two_pi = np.float32(2.0 * math.pi)
    for row in numba.prange(nz * ny):
        iz, iy = row // ny, row % ny
        tx_bins = np.empty((n_tx, nx), dtype=np.float32)
        rx_bins = np.empty((n_rx, nx), dtype=np.float32)
        tx_phasor = np.empty((n_tx, nx), dtype=np.complex64)
        rx_phasor = np.empty((n_rx, nx), dtype=np.complex64)
        for antennas, bins, phasor in ((tx_m, tx_bins, tx_phasor), (rx_m, rx_bins, rx_phasor)):
            for a in range(len(antennas)):
                for ix in range(nx):
                    d = math.sqrt(
                        (x_m[ix] - antennas[a, 0]) ** 2
                        + (y_m[iy] - antennas[a, 1]) ** 2
                        + (z_m[iz] - antennas[a, 2]) ** 2
                    )
                    bins[a, ix] = d * bins_per_m
                    angle = two_pi * np.float32((d * k) % 1.0)
                    phasor[a, ix] = complex(math.cos(angle), math.sin(angle))
        total = np.zeros(nx, dtype=np.complex64)
        inner = np.empty(nx, dtype=np.complex64)
        offset = np.float32(first_m * bins_per_m)
        for t in range(n_tx):
            inner[:] = 0
            for r in range(n_rx):
                for ix in range(nx):
                    at = tx_bins[t, ix] + rx_bins[r, ix] - offset
                    b = int(at)
                    f = np.float32(at - b)
                    p = profiles[t, r, b]
                    p += f * (profiles[t, r, b + 1] - p)
                    inner[ix] += p * rx_phasor[r, ix]
            for ix in range(nx):
                total[ix] += inner[ix] * tx_phasor[t, ix]
        out[iz, iy] = total / (n_tx * n_rx)
    return out


def by_numpy(name: str, call: Callable[[], Any]) -> dict[str, Callable[[], Any]]:
    """A peer whose matrix products numpy gives to BLAS, with all its threads and with one."""

    def in_one_thread() -> Any:
        with threadpool_limits(1, "blas"):
            return call()

    return {f"numpy, {name}": call, "BLAS in one thread": in_one_thread}


class MitsubaRays:
    """Mitsuba 3 by LLVM and Embree, one thread per core; queries leave their results there."""

    name = "Mitsuba, LLVM, all cores"

    def __init__(self, triangles_m: np.ndarray) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")  # an error where there is no libLLVM
        self._dr, self._mi = drjit, mitsuba
        n = len(triangles_m)
        mesh = mitsuba.Mesh("mesh", 3 * n, n)
        parameters = mitsuba.traverse(mesh)
        corners = np.asarray(triangles_m, dtype=np.float32).reshape(-1)
        parameters["vertex_positions"] = mitsuba.Float(corners)
        parameters["faces"] = mitsuba.UInt32(np.arange(3 * n, dtype=np.uint32))
        parameters.update()
        self._scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})
        self._rays: Any = None
        self._answer: Any = None

    def prepare(self, origins_m: np.ndarray, directions: np.ndarray) -> None:
        mi = self._mi
        o, d = (mi.Point3f(np.ascontiguousarray(a.T)) for a in (origins_m, directions))
        self._rays = mi.Ray3f(o, mi.Vector3f(d), time=mi.Float(0), wavelengths=mi.Color0f())
        self._ended = mi.Ray3f(self._rays)
        self._ended.maxt = mi.Float(1.0)
        self._dr.eval(self._rays, self._ended)

    def query_blocked(self) -> None:
        self._answer = self._scene.ray_test(self._ended)
        self._dr.eval(self._answer)
        self._dr.sync_thread()

    def blocked(self) -> np.ndarray:
        self.query_blocked()
        return np.array(self._answer)

    def query_faces(self) -> None:
        self._answer = self._scene.ray_intersect_preliminary(self._rays, coherent=False)
        self._dr.eval(self._answer.t, self._answer.prim_index)
        self._dr.sync_thread()

    def faces(self) -> np.ndarray:
        self.query_faces()
        met = np.isfinite(np.array(self._answer.t))
        return np.where(met, np.array(self._answer.prim_index).astype(np.int64), -1)

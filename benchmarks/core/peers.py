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


def finufft_phasor_sum(
    start: np.ndarray, k_per_m: np.ndarray, eps: float, length_m: np.ndarray, amplitude: np.ndarray
) -> Callable[..., np.ndarray]:
    """SFCW sum of paths sorted by pair, equal steps, by finufft's type 1, (n_pairs, n_freq).

    The fastest way to use finufft at its accuracy: a plan per thread, which takes the points of one
    pair after the other and does not sort them (docs/performance.md).
    """
    n_pairs, n_freq = len(start) - 1, len(k_per_m)
    # Mode 0 is the frequency in the middle; its phasor goes into the strengths.
    turns, steps = k_per_m[n_freq // 2] * length_m, np.ptp(k_per_m) / (n_freq - 1) * length_m
    phasor = np.exp(-2j * np.pi * (turns - np.rint(turns)))
    strength = (amplitude * phasor).astype(np.complex64)
    point = (2 * np.pi * (steps - np.rint(steps))).astype(np.float32)

    def transform(threads: int = 1) -> np.ndarray:
        out = np.zeros((n_pairs, n_freq), dtype=np.complex64)

        def some(pairs: range) -> None:
            plan = finufft.Plan(
                1, (n_freq,), 1, eps, -1, dtype="complex64", nthreads=1, spread_sort=0
            )
            for pair in pairs:
                rows = slice(start[pair], start[pair + 1])
                if rows.stop > rows.start:
                    plan.setpts(point[rows])
                    plan.execute(strength[rows], out=out[pair])

        bounds = [n_pairs * i // threads for i in range(threads + 1)]
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(some, map(range, bounds[:-1], bounds[1:])))
        return out

    return transform


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
        bins = np.empty((n_tx + n_rx, nx), dtype=np.float32)
        phasor = np.empty((n_tx + n_rx, nx), dtype=np.complex64)
        for a in range(n_tx + n_rx):
            x, y, z = tx_m[a] if a < n_tx else rx_m[a - n_tx]
            for ix in range(nx):
                d = math.sqrt((x_m[ix] - x) ** 2 + (y_m[iy] - y) ** 2 + (z_m[iz] - z) ** 2)
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
                    at = bins[t, ix] + bins[n_tx + r, ix] - offset
                    b = int(at)
                    f = np.float32(at - b)
                    p = profiles[t, r, b]
                    p += f * (profiles[t, r, b + 1] - p)
                    inner[ix] += p * phasor[n_tx + r, ix]
            for ix in range(nx):
                total[ix] += inner[ix] * phasor[t, ix]
        out[iz, iy] = total / (n_tx * n_rx)
    return out


def by_numpy(name: str, call: Callable[[], Any]) -> dict[str, Callable[[], Any]]:
    """A peer whose matrix products numpy gives to BLAS, with all its threads and with one."""

    def in_one_thread() -> Any:
        with threadpool_limits(1, "blas"):
            return call()

    return {f"numpy, {name}": call, "BLAS in one thread": in_one_thread}


class MitsubaRays:
    """Mitsuba 3 by LLVM and Embree, one thread per core; results stay there until `answer`."""

    name = "Mitsuba, LLVM, all cores"

    def __init__(
        self, triangles_m: np.ndarray, origins_m: np.ndarray, directions: np.ndarray
    ) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")  # an error where there is no libLLVM
        self._dr, n = drjit, len(triangles_m)
        mesh = mitsuba.Mesh("mesh", 3 * n, n)
        parameters = mitsuba.traverse(mesh)
        corners = np.asarray(triangles_m, dtype=np.float32).reshape(-1)
        parameters["vertex_positions"] = mitsuba.Float(corners)
        parameters["faces"] = mitsuba.UInt32(np.arange(3 * n, dtype=np.uint32))
        parameters.update()
        self._scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})
        o, d = (mitsuba.Point3f(np.ascontiguousarray(a.T)) for a in (origins_m, directions))
        self._rays = mitsuba.Ray3f(
            o, mitsuba.Vector3f(d), time=mitsuba.Float(0), wavelengths=mitsuba.Color0f()
        )
        self._ended = mitsuba.Ray3f(self._rays)
        self._ended.maxt = mitsuba.Float(1.0)
        drjit.eval(self._rays, self._ended)

    def blocked(self) -> tuple[Any, ...]:
        """Whether each ray is blocked within its length."""
        return self._made(self._scene.ray_test(self._ended))

    def faces(self) -> tuple[Any, ...]:
        """The nearest face of each ray, and its distance."""
        found = self._scene.ray_intersect_preliminary(self._rays, coherent=False)
        return self._made(found.prim_index, found.t)

    def _made(self, *found: Any) -> tuple[Any, ...]:
        self._dr.eval(*found)
        self._dr.sync_thread()
        return found


def answer(found: Any, distance: Any = None) -> np.ndarray:
    """What Mitsuba found, -1 where it met nothing."""
    if distance is None:
        return np.array(found)
    return np.where(np.isfinite(np.array(distance)), np.array(found).astype(np.int64), -1)

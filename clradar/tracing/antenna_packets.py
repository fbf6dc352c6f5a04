"""Antennas as ``visibility.cl`` reads them: in bundles of groups that are close to each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clradar.opencl import Device

GROUP = 8
"""Antennas per group in the kernels."""

BUNDLE = 8 * GROUP
"""Most antennas that one pass through the tree serves."""

BUNDLE_FLOATS = 320
"""Length of a bundle in ``kernels/visibility.cl``."""


def bundled(positions_m: np.ndarray, filler_m: np.ndarray | None = None) -> np.ndarray:
    """Return what the kernels of ``visibility.cl`` read of antennas.

    Parameters
    ----------
    positions_m : ndarray, shape (n, 3), float64, metres
    filler_m : ndarray, shape (3,), optional
        What fills up the last group; the last position by default.

    Returns
    -------
    ndarray, shape (m,), float32
        The positions by coordinate, (3, n_groups * GROUP), the number of bundles, and the bundles.
    """
    positions = np.asarray(positions_m, dtype=np.float32)
    n_groups = -(-len(positions) // GROUP)
    columns = np.empty((3, n_groups * GROUP), dtype=np.float32)
    columns[:] = np.asarray(positions[-1] if filler_m is None else filler_m)[:, None]
    columns[:, : len(positions)] = positions.T
    bundles = [
        _bundle(positions, list(_split(positions, members, GROUP)))
        for members in _split(positions, np.arange(len(positions)), BUNDLE)
    ]
    header = np.zeros(8, dtype=np.int32)
    header[0] = len(bundles)
    return np.concatenate([columns.ravel(), header.view(np.float32), *bundles])


def items(device: Device, n_points: int, n_groups: int) -> tuple[int, int]:
    """Return over how many items the kernels of ``visibility.cl`` are launched."""
    return n_points, 1 if device.width == 8 else n_groups


def _split(positions_m: np.ndarray, members: np.ndarray, most: int) -> Iterator[np.ndarray]:
    """Halve the longest side until no part has more than `most` members; each part is sorted."""
    if len(members) <= most:
        yield np.sort(members)
        return
    mine = positions_m[members]
    axis = int(np.ptp(mine, axis=0).argmax())
    ranked = members[np.argsort(mine[:, axis], kind="stable")]
    half = len(members) // 2
    # Parts that are full leave less to pad.
    if most == GROUP:
        half = -(-half // GROUP) * GROUP
    yield from _split(positions_m, ranked[:half], most)
    yield from _split(positions_m, ranked[half:], most)


def _bundle(positions_m: np.ndarray, groups: list[np.ndarray]) -> np.ndarray:
    out = np.zeros(BUNDLE_FLOATS, dtype=np.float32)
    words = out.view(np.int32)
    words[0] = len(groups)
    first, low, high = words[8:16], out[16:40].reshape(3, 8), out[40:64].reshape(3, 8)
    at, antenna = out[64:256].reshape(3, 8, 8), words[256:320].reshape(8, 8)
    antenna[:] = -1
    for g in range(8):
        members = groups[min(g, len(groups) - 1)]
        filled = members[np.minimum(np.arange(GROUP), len(members) - 1)]
        at[:, g] = positions_m[filled].T
        low[:, g], high[:, g] = at[:, g].min(axis=1), at[:, g].max(axis=1)
        first[g] = -1
        if g < len(groups):
            antenna[g, : len(members)] = members
            if members[-1] - members[0] == len(members) - 1:
                first[g] = members[0]
    return out

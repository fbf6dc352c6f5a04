"""Antennas in bundles of ray packets, as the shaft traversal of ``visibility.cl`` reads them.

A group of antennas that are close to each other makes a packet of rays, which are tested together
(I. Wald et al., "Interactive rendering with coherent ray tracing", Eurographics 2001). A bundle of
groups makes a shaft, which is traversed once for all (E. A. Haines and J. R. Wallace, "Shaft
culling for efficient ray-traced radiosity", Eurographics Workshop on Rendering 1991).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clradar.geometry.bvh import TraversalOptions
from clradar.opencl import Device

GROUP = 8  # antennas per group, and bits per byte of what is visible
BUNDLE_GROUPS = 8  # most groups that one pass through the tree serves
BUNDLE = np.dtype(
    [
        ("n_groups", np.int32),
        ("unused", np.int32, 7),
        ("first", np.int32, BUNDLE_GROUPS),
        ("low", np.float32, (3, BUNDLE_GROUPS)),
        ("high", np.float32, (3, BUNDLE_GROUPS)),
        ("position", np.float32, (3, BUNDLE_GROUPS, GROUP)),
        ("antenna", np.int32, (BUNDLE_GROUPS, GROUP)),
    ]
)
"""A bundle, as `bundle` in ``visibility.cl``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibilityOptions(TraversalOptions):
    """Options of ``visibility.cl``."""

    group: int = GROUP
    bundle_groups: int = BUNDLE_GROUPS


def bundled(positions_m: np.ndarray, filler_m: np.ndarray | None = None) -> np.ndarray:
    """Lay out antennas, shape (n, 3), for the kernels of ``visibility.cl``, as float32 (m,).

    The positions by coordinate, (3, n_groups * GROUP), the number of bundles and seven unused
    words, and the bundles. `filler_m` fills up the last group; by default the last position does.
    """
    positions = np.asarray(positions_m, dtype=np.float32)
    columns = np.empty((3, n_groups(len(positions)) * GROUP), dtype=np.float32)
    columns[:] = np.asarray(positions[-1] if filler_m is None else filler_m)[:, None]
    columns[:, : len(positions)] = positions.T
    parts = list(_split(positions, np.arange(len(positions)), BUNDLE_GROUPS * GROUP))
    bundles = np.zeros(len(parts), BUNDLE)
    for bundle, members in zip(bundles, parts, strict=True):
        _fill(bundle, positions, list(_split(positions, members, GROUP)))
    header = np.array([len(bundles), *[0] * 7], dtype=np.int32)
    return np.concatenate([columns.ravel(), header.view(np.float32), bundles.view(np.float32)])


def n_groups(n_antennas: int) -> int:
    """How many groups hold `n_antennas`."""
    return -(-n_antennas // GROUP)


def items(device: Device, n_points: int, groups: int) -> tuple[int, int]:
    """Over how many items the kernels of ``visibility.cl`` are launched."""
    return 1 if device.width == 8 else groups, n_points


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


def _fill(bundle: np.void, positions_m: np.ndarray, groups: list[np.ndarray]) -> None:
    bundle["n_groups"] = len(groups)
    bundle["first"] = bundle["antenna"] = -1
    for g in range(BUNDLE_GROUPS):
        members = groups[min(g, len(groups) - 1)]
        filled = positions_m[members[np.minimum(np.arange(GROUP), len(members) - 1)]]
        bundle["position"][:, g] = filled.T
        bundle["low"][:, g], bundle["high"][:, g] = filled.min(axis=0), filled.max(axis=0)
        if g < len(groups):
            bundle["antenna"][g, : len(members)] = members
            if members[-1] - members[0] == len(members) - 1:
                bundle["first"][g] = members[0]

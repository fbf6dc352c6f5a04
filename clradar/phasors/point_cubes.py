"""Cubes of space around points, within which phases vary slowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOST_CUBES_A_SIDE = 2**20  # of the region: three indices make one number of 64 bits


@dataclass(frozen=True, slots=True, eq=False)
class PointCubes:
    """The occupied cubes of a lattice, in the order of their indices."""

    centre_m: np.ndarray  # (n_cubes, 3), float32
    order: np.ndarray  # (n_points,), int: points cube by cube, those of a cube in their order
    cube: np.ndarray  # (n_points,), int32: cube of each point, in that order, ascending


def cubes_of(position_m: np.ndarray, edge_m: float) -> PointCubes:
    """Sort points into cubes.

    Parameters
    ----------
    position_m : ndarray, shape (n, 3), metres
    edge_m : float, metres
    """
    index = np.floor(position_m.astype(np.float64) / edge_m).astype(np.int64)
    low = index.min(axis=0, initial=0)
    if (index - low).max(initial=0) >= MOST_CUBES_A_SIDE:
        raise ValueError(f"{index.max()} cubes of {edge_m} m")
    x, y, z = (index - low).T
    key = (x * MOST_CUBES_A_SIDE + y) * MOST_CUBES_A_SIDE + z
    order = np.argsort(key, kind="stable")
    _, first, cube = np.unique(key[order], return_index=True, return_inverse=True)
    centre_m = (index[order[first]] + 0.5) * edge_m
    return PointCubes(centre_m.astype(np.float32), order, cube.astype(np.int32))

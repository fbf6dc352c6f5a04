"""Signed distance from a hand's flesh in float64 numpy, sharing no code with its kernels."""

import numpy as np

from clradar.hand.flesh import Flesh


def cone_distance_m(points_m: np.ndarray, cone: np.ndarray) -> np.ndarray:
    """Signed distance, shape (n,), from the convex hull of two spheres.

    `cone` has both centres, then both radii, shape (8,). The hull's distance is the least of
    f(s) = |p - c(s)| - r(s) over the spheres between both, 0 <= s <= 1, with c and r linear. f is
    convex, and f' = 0 where s is beyond the foot of p by dr q / (L sqrt(L^2 - dr^2)), with q the
    distance of p from the axis, L its length and dr by how much the second radius is larger.
    """
    begin_m, along_m, radius_m, more_m = cone[:3], cone[3:6] - cone[:3], cone[6], cone[7] - cone[6]
    length_m = np.sqrt(along_m @ along_m)
    from_m = points_m - begin_m
    foot = from_m @ along_m / length_m**2
    off_m = np.linalg.norm(np.cross(from_m, along_m), axis=1) / length_m
    s = np.clip(foot + more_m * off_m / (length_m * np.sqrt(length_m**2 - more_m**2)), 0, 1)
    return np.linalg.norm(from_m - s[:, None] * along_m, axis=1) - (radius_m + s * more_m)


def blended_m(a_m: np.ndarray, b_m: np.ndarray, blend_m: float) -> np.ndarray:
    """Minimum, lowered by (blend - |a - b|)^2 / (4 blend) where the two differ by less."""
    missing_m = np.clip(blend_m - np.abs(a_m - b_m), 0, None)
    return np.minimum(a_m, b_m) - missing_m**2 / (4 * blend_m)


def united_m(points_m: np.ndarray, cones: np.ndarray, blend_m: float) -> np.ndarray:
    """Cones, shape (n_cones, 8), blended in their order."""
    distance_m = cone_distance_m(points_m, cones[0])
    for cone in cones[1:]:
        distance_m = blended_m(distance_m, cone_distance_m(points_m, cone), blend_m)
    return distance_m


def flesh_distance_m(
    points_m: np.ndarray, forearm: np.ndarray, palm: np.ndarray, digits: np.ndarray
) -> np.ndarray:
    """Signed distance, shape (n,), from a hand's flesh in the frame of its wrist.

    Parameters
    ----------
    points_m : ndarray, shape (n, 3), metres
    forearm : ndarray, shape (3,)
        Unit vector from the elbow to the wrist.
    palm : ndarray, shape (n_cones, 8)
    digits : ndarray, shape (n_digits, 6, 8)
        Two cones each that grow out of the palm, and the four beyond.
    """
    bare_m = united_m(points_m, palm, 9e-3)
    whole_m = bare_m
    for cones in digits:
        root_m, end_m = united_m(points_m, cones[:2], 2.5e-3), united_m(points_m, cones[2:], 2.5e-3)
        # Only its root runs widely into the palm.
        digit_m = np.minimum(blended_m(bare_m, root_m, 6e-3), blended_m(root_m, end_m, 2.5e-3))
        whole_m = blended_m(whole_m, digit_m, 1e-3)
    # Cut 9 mm below the wrist.
    return -blended_m(-whole_m, points_m @ forearm + 9e-3, 2e-3)


def part_distances_m(points_m: np.ndarray, palm: np.ndarray, digits: np.ndarray) -> np.ndarray:
    """Signed distances, shape (1 + n_digits, n), from the palm and from each digit alone."""
    alone_m = [united_m(points_m, cones, 2.5e-3) for cones in digits]
    return np.stack([united_m(points_m, palm, 9e-3), *alone_m])


STEP_M = 1e-6
"""Of the central differences: rounding of distances near 0.1 m, 1e-17 m, is 1e-11 of it."""


def rows(cones: np.ndarray) -> np.ndarray:
    """Return cones (..., 2, 4) as the reference takes them, shape (..., 8)."""
    return np.concatenate([cones[..., 0, :3], cones[..., 1, :3], cones[..., 3]], axis=-1)


def digits(flesh: Flesh) -> np.ndarray:
    return rows(np.concatenate([flesh.roots, flesh.ends], axis=1))


def distances_m(flesh: Flesh, points_m: np.ndarray) -> np.ndarray:
    """Return the signed distances (N,) of points (N, 3)."""
    return flesh_distance_m(points_m, flesh.forearm, rows(flesh.palm), digits(flesh))


def gradients(flesh: Flesh, points_m: np.ndarray) -> np.ndarray:
    """Return the gradients (N, 3) of the distances, by central differences."""
    ahead, behind = (
        [distances_m(flesh, points_m + s * STEP_M * axis) for axis in np.eye(3)] for s in (1, -1)
    )
    return (np.stack(ahead, axis=1) - np.stack(behind, axis=1)) / (2 * STEP_M)

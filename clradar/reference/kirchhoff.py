"""The Kirchhoff sum over a rough, curved surface in float64 numpy.

    u(t, r, f) = (j k / 4 pi) Sum_p V_t V_r Gamma_p ((s_t + s_r).w_p N_p)
                 exp(-j k (R_t + R_r)) / (R_t R_r)
    s(t, r, f) = sqrt(G_t G_r) (lambda / 4 pi) u

Physical optics over points of a quadrature [1]_ [2]_. Slow and plain on purpose: it shares no code
with the kernels and their host side, which are compared with it.

References
----------
.. [1] C. A. Balanis, Advanced Engineering Electromagnetics, 2nd ed., Wiley 2012, sections 7.10 and
   11.3 (physical optics).
.. [2] E. I. Thorsos, "The validity of the Kirchhoff approximation for rough surface scattering
   using a Gaussian roughness spectrum", J. Acoust. Soc. Am. 83 (1988) 78.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from clradar.model import AntennaArray, Scene
from clradar.reference import (
    C_M_PER_S,
    counters,
    curved_points,
    philox,
    scene_normals,
    uniform,
    visible,
)

N_WAVES = 512  # plane waves that a height field is made of
DOMAIN_WAVE = 4  # last word of the counters of a height field's random numbers


@dataclass(frozen=True)
class Quadrature:
    """Points of a surface and the vector areas that they stand for.

    Visibility is asked from `flat_m`, the point's place on the flat `face`. `moment_m2` is the mean
    of x x^T over the sub-triangle about its centroid, in the surface's tangent plane; 0 of rough
    surfaces, whose phase is not linear over it.
    """

    point_m: np.ndarray  # (n, 3)
    area_m2: np.ndarray  # (n, 3): area undisplaced, times the displaced surface's n - grad eta
    normal: np.ndarray  # (n, 3): unit normals n of the undisplaced surface
    flat_m: np.ndarray  # (n, 3)
    face: np.ndarray  # (n,)
    texture_m: np.ndarray  # (n, 3), in the coordinates in which roughness is defined
    moment_m2: np.ndarray  # (n, 3, 3)


def sub_triangles(cuts: int) -> np.ndarray:
    """Barycentric corners of the cuts^2 equal parts of a triangle, shape (cuts^2, 3, 3)."""
    parts = []
    for i in range(cuts):
        for j in range(cuts - i):
            parts.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < cuts - 1:
                parts.append([(i + 1, j), (i + 1, j + 1), (i, j + 1)])
    ij = np.array(parts, float) / cuts
    return np.stack([1 - ij[..., 0] - ij[..., 1], ij[..., 0], ij[..., 1]], axis=2)


def quadrature(
    scene: Scene, cuts: np.ndarray, *, facets: str = "curved", crease_deg: float = 30.0
) -> Quadrature:
    """Centroids of cuts^2 sub-triangles of every face, `cuts` of shape (n_faces,).

    The vector area is that of the curved surface's tangent plane there. Normals of the scene's own
    hold where they are known and within 60 degrees of the face's.
    """
    flat_normal, corner_normal = scene_normals(scene, "smooth", crease_deg)
    if scene.normals is not None:
        given = scene.normals[scene.faces]
        cosine = np.einsum("fka,fa->fk", given, flat_normal)
        given = given * np.sign(cosine)[..., None]
        corner_normal = np.where((np.abs(cosine) >= 0.5)[..., None], given, corner_normal)
    parts = [sub_triangles(int(n)) for n in cuts]
    corner = np.concatenate(parts)
    face = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    weight = corner.mean(axis=1)
    corner_m, shading = scene.triangles_m[face], corner_normal[face]
    flat_m = np.einsum("pk,pka->pa", weight, corner_m)
    if facets == "flat":
        shading = np.repeat(flat_normal[face][:, None], 3, axis=1)
    point_m = curved_points(corner_m, shading, weight)
    along = tangents(weight, corner_m, shading)
    across = np.cross(*along)
    about = np.einsum("pcj,jpa->pca", (corner - weight[:, None])[..., 1:], np.stack(along))
    moment_m2 = np.einsum("pca,pcb->pab", about, about) / 12  # exact for a triangle
    across *= np.sign(np.einsum("pa,pa->p", across, flat_normal[face]))[:, None]
    share = 1 / (2 * np.square(cuts)[face])
    normal = across / np.linalg.norm(across, axis=1, keepdims=True)
    at = point_m
    if scene.texture_m is not None:
        at = _in_texture(scene.texture_m[scene.faces][face], corner_m, weight, point_m - flat_m)
    return Quadrature(point_m, share[:, None] * across, normal, flat_m, face, at, moment_m2)


def tangents(
    weight: np.ndarray, corner_m: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of `curved` by the second and third weight, the first being the rest."""
    flat = np.einsum("pk,pka->pa", weight, corner_m)
    off = np.einsum("pka,pka->pk", corner_m - flat[:, None], normal)
    out = []
    for j in (1, 2):
        edge = corner_m[:, j] - corner_m[:, 0]
        by = -weight * np.einsum("pa,pka->pk", edge, normal)
        by[:, j] += off[:, j]
        by[:, 0] -= off[:, 0]
        out.append(edge + 0.5 * np.einsum("pk,pka->pa", by, normal))
    return out[0], out[1]


def _in_texture(
    texture_m: np.ndarray, corner_m: np.ndarray, weight: np.ndarray, offset_m: np.ndarray
) -> np.ndarray:
    """Places in the body's coordinates: the face's, and the offset turned from face to face."""

    def frame(corners: np.ndarray) -> np.ndarray:
        e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        up = np.cross(e1, e2)
        return np.stack([e1, e2, up / np.linalg.norm(up, axis=1, keepdims=True)], axis=2)

    flat = np.einsum("pk,pka->pa", weight, texture_m)
    parts = np.linalg.solve(frame(corner_m), offset_m[..., None])
    return flat + (frame(texture_m) @ parts)[..., 0]


def waves(seed: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Wave vectors for a correlation length of 1, shape (N_WAVES, 3), and phases of a height field.

    Every material has its own, by the first 32 bits of the SHA-256 of its name. Each component is
    normal with the standard deviation sqrt(2) (Box and Muller), so that the correlation over a
    distance r is E cos(K.r) = exp(-r^2).
    """
    material = int(np.frombuffer(hashlib.sha256(name.encode()).digest(), "<u4")[0])
    index = np.arange(N_WAVES, dtype=np.uint64)
    first = uniform(philox(counters(index, 0, material, DOMAIN_WAVE), seed))
    second = uniform(philox(counters(index, 1, material, DOMAIN_WAVE), seed))
    radius = np.sqrt(-2 * np.log(first[:, 0]))
    third = np.sqrt(-2 * np.log(first[:, 2])) * np.cos(2 * np.pi * first[:, 3])
    angle = 2 * np.pi * first[:, 1]
    k = np.stack([radius * np.cos(angle), radius * np.sin(angle), third], axis=1)
    return np.sqrt(2) * k, 2 * np.pi * second[:, 0]


def roughened(
    surface: Quadrature, rms_m: float, correlation_m: float, seed: int, name: str
) -> Quadrature:
    """The surface displaced along its normals by a height field of Gaussian correlation.

    eta(q) = h sqrt(2/M) Sum_m cos(K_m.q / l + phi_m), and N = n - grad eta along the surface.
    """
    k, phase = waves(seed, name)
    scale = rms_m * np.sqrt(2 / N_WAVES)
    height = np.empty(len(surface.point_m))
    slope = np.empty((len(surface.point_m), 3))
    for at in range(0, len(height), 4096):
        part = slice(at, at + 4096)
        angle = surface.texture_m[part] @ k.T / correlation_m + phase
        height[part] = scale * np.cos(angle).sum(axis=1)
        slope[part] = -scale / correlation_m * np.sin(angle) @ k
    n = surface.normal
    along = slope - np.einsum("pa,pa->p", slope, n)[:, None] * n
    area = np.einsum("pa,pa->p", surface.area_m2, n)[:, None]
    return replace(
        surface,
        point_m=surface.point_m + height[:, None] * n,
        area_m2=area * (n - along),
        moment_m2=np.zeros_like(surface.moment_m2),
    )


def seen_side(surface: Quadrature, scene: Scene, antenna_m: np.ndarray) -> np.ndarray:
    """1 where an antenna sees the front of a point, -1 the back, 0 nothing: (n, n_antennas) int8.

    By brute force over all triangles. The antenna has to be on the same side of the flat face and
    of the tangent plane of the undisplaced surface.
    """
    triangles = scene.triangles_m
    flat = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    flat = (flat / np.linalg.norm(flat, axis=1, keepdims=True))[surface.face]
    out = np.zeros((len(surface.face), len(antenna_m)), np.int8)
    for a, at_m in enumerate(antenna_m):
        side = np.sign(np.einsum("pa,pa->p", surface.normal, at_m - surface.flat_m))
        same = side == np.sign(np.einsum("pa,pa->p", flat, at_m - surface.flat_m)) * np.sign(
            np.einsum("pa,pa->p", flat, surface.normal)
        )
        clear = visible(surface.flat_m, flat, np.broadcast_to(at_m, flat.shape), triangles)
        out[:, a] = np.where(same & clear, side, 0)
    return out


def towards_antennas(
    surface: Quadrature, tx_side: np.ndarray, rx_side: np.ndarray
) -> tuple[Quadrature, np.ndarray, np.ndarray]:
    """Points that some Tx and Rx see, turned so that it is from the front, and what sees them.

    A point that is seen from either side is there twice. Roughness then stands out towards the
    antennas, whichever way a face is wound.
    """
    rows, signs = [], []
    for side in (1, -1):
        seen = np.flatnonzero((tx_side == side).any(axis=1) & (rx_side == side).any(axis=1))
        rows.append(seen)
        signs.append(np.full(len(seen), side))
    row, sign = np.concatenate(rows), np.concatenate(signs)
    turn = sign[:, None]
    turned = Quadrature(
        surface.point_m[row],
        surface.area_m2[row] * turn,
        surface.normal[row] * turn,
        surface.flat_m[row],
        surface.face[row],
        surface.texture_m[row],
        surface.moment_m2[row],
    )
    front = [(side[row] == turn).astype(np.int8) for side in (tx_side, rx_side)]
    return turned, front[0], front[1]


def fresnel(permittivity: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Gamma = (r_s - r_p)/2 of a half space, (n_freq,) and (...) to (..., n_freq); eps' - j eps''.

    r_p is that of the magnetic field, -r_s at normal incidence [1]_.
    """
    c = np.asarray(cosine, float)[..., None]
    inner = np.sqrt(permittivity - (1 - c**2) + 0j)  # principal: decays inwards
    r_s = (c - inner) / (c + inner)
    r_p = (permittivity * c - inner) / (permittivity * c + inner)
    return (r_s - r_p) / 2


def leg(permittivity: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """g = sqrt(-Gamma) at one leg's angle of incidence, of shape (n, n_antennas, n_freq).

    -Gamma of a half space has a real part above 0, so the principal root is continuous.
    """
    return np.sqrt(-fresnel(permittivity, cosine))


def kirchhoff(
    surface: Quadrature,
    array: AntennaArray,
    frequencies_hz: np.ndarray,
    tx_side: np.ndarray,
    rx_side: np.ndarray,
    *,
    tx_leg: np.ndarray | float = 1.0,
    rx_leg: np.ndarray | float = 1.0,
    tx_field: np.ndarray | float = 1.0,
    rx_field: np.ndarray | float = 1.0,
) -> np.ndarray:
    """S-parameters of single reflections, complex128 of shape (n_tx, n_rx, n_freq).

    The phase is linear over a sub-triangle of second moment M: its mean is exp(-k^2 q.M.q / 2) to
    second order, q = s_t + s_r, with the exponent linear about Q: k^2 (q.M.Q - Q.M.Q / 2). Q is the
    sum of the unit vectors to the middles of the Tx and of the Rx that see the point, along the
    surface, and shorter by the RMS radii of Tx and Rx over the distances to these middles, or 0.

    Sides, (n, n_tx) and (n, n_rx), are of `seen_side`: what Tx and Rx see from different ones does
    not count. Legs, (n, n_tx, n_freq) and (n, n_rx, n_freq), are g of `leg`: Gamma = -g_t g_r, 1
    for a perfect conductor. Fields, shaped as sides, are antenna patterns towards the points, times
    the roots of the gains.
    """
    out = np.zeros((array.n_tx, array.n_rx, len(frequencies_hz)), complex)
    mean = np.zeros_like(surface.point_m)
    spread = np.zeros((len(mean), 1))
    for at_m, seen in ((array.tx_m, np.abs(tx_side)), (array.rx_m, np.abs(rx_side))):
        middle_m = seen @ at_m / np.maximum(seen.sum(axis=1), 1)[:, None]
        to = middle_m - surface.point_m
        distance = np.linalg.norm(to, axis=1, keepdims=True)
        mean += to / distance
        spread += np.sqrt(np.mean(np.sum((at_m - at_m.mean(axis=0)) ** 2, axis=1))) / distance
    unit = surface.area_m2 / np.linalg.norm(surface.area_m2, axis=1, keepdims=True)
    mean -= np.einsum("pa,pa->p", mean, unit)[:, None] * unit
    size = np.linalg.norm(mean, axis=1, keepdims=True)
    mean *= np.maximum(size - spread, 0) / np.where(size > 0, size, 1)
    damping = np.einsum("pab,pb->pa", surface.moment_m2, mean)
    level = np.einsum("pa,pa->p", damping, mean) / 4
    legs = []
    for at_m, g, field in ((array.tx_m, tx_leg, tx_field), (array.rx_m, rx_leg, rx_field)):
        to = at_m - surface.point_m[:, None]
        r = np.linalg.norm(to, axis=2)
        along = np.einsum("pxa,pa->px", to, surface.area_m2) / r
        g = np.broadcast_to(g, (*r.shape, len(frequencies_hz)))
        slope = np.einsum("pxa,pa->px", to, damping) / r
        legs.append((r, along, g, np.broadcast_to(field, r.shape) / r, slope - level[:, None]))
    (r_t, along_t, g_t, field_t, spread_t), (r_r, along_r, g_r, field_r, spread_r) = legs
    for m, f in enumerate(frequencies_hz):
        k = 2 * np.pi * f / C_M_PER_S
        wave_t = g_t[:, :, m] * field_t * np.exp(-1j * k * r_t - k**2 * spread_t)
        wave_r = g_r[:, :, m] * field_r * np.exp(-1j * k * r_r - k**2 * spread_r)
        for side in (1, -1):
            at, ar = wave_t * (tx_side == side), wave_r * (rx_side == side)
            total = (at * along_t).T @ ar + at.T @ (ar * along_r)
            out[:, :, m] += 1j * k / (4 * np.pi) * -side * total  # Gamma = -g_t g_r
        out[:, :, m] *= C_M_PER_S / f / (4 * np.pi)
    return out

"""Reference implementation of tracing, phasor sum and back-projection in float64 numpy.

Slow and plain on purpose, and without shared code: the tests compare every kernel with these
functions. They use the same counter-based random numbers, so that each traced path has its
counterpart.

References
----------
.. [1] J. Braeunig et al., "A Realistic Radar Ray Tracing Simulator for Hand Pose Imaging",
   EuRAD 2023.
.. [2] J. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011 (Philox4x32-10).
.. [3] T. Moeller, B. Trumbore, J. Graphics Tools 2 (1997) 21.
.. [4] T. Boubekeur, M. Alexa, "Phong tessellation", ACM TOG 27(5) (2008) 141; with the factor 1/2.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from clradar.model import AntennaArray, Capture, Paths, Scene, Waveform

C_M_PER_S = 299_792_458.0
LIFT_M = 1e-6
"""Height above a surface at which rays leave it, so that they do not hit their own face."""


def philox(counter: np.ndarray, seed: int) -> np.ndarray:
    """Philox4x32-10 [2]_: counters, shape (n, 4), to random words of 32 bits, shape (n, 4)."""
    mask = np.uint64(0xFFFFFFFF)
    x = [np.asarray(counter[:, k], dtype=np.uint64) & mask for k in range(4)]
    k0, k1 = seed & 0xFFFFFFFF, seed >> 32
    for _ in range(10):
        a = np.uint64(0xD2511F53) * x[0]
        b = np.uint64(0xCD9E8D57) * x[2]
        x = [
            (b >> np.uint64(32)) ^ x[1] ^ np.uint64(k0),
            b & mask,
            (a >> np.uint64(32)) ^ x[3] ^ np.uint64(k1),
            a & mask,
        ]
        k0 = (k0 + 0x9E3779B9) & 0xFFFFFFFF
        k1 = (k1 + 0xBB67AE85) & 0xFFFFFFFF
    return np.stack(x, axis=1)


def uniform(words: np.ndarray) -> np.ndarray:
    """Middle of one of 2^23 cells of (0, 1)."""
    return ((words >> np.uint64(9)).astype(np.float64) + 0.5) / 2**23


def counters(c0: np.ndarray, c1: int, c2: int, c3: int) -> np.ndarray:
    out = np.empty((len(c0), 4), dtype=np.uint64)
    out[:, 0], out[:, 1], out[:, 2], out[:, 3] = c0, c1, c2, c3
    return out


def smooth_normals(scene: Scene, crease_deg: float) -> np.ndarray:
    """Corner normals with creases, face by face: shape (n_faces, 3, 3)."""
    corners = scene.triangles_m
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    normal = np.where(size[:, None] > 0, cross / np.maximum(size, 1e-300)[:, None], 0)
    key = [[tuple(p) for p in face] for face in corners]
    by_edge = defaultdict(list)
    for f, face in enumerate(key):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            by_edge[frozenset((face[a], face[b]))].append(f)
    joined = defaultdict(set)  # (face, vertex) -> (face, vertex) across a smooth edge
    for edge, faces in by_edge.items():
        for f, g in pairwise(faces):
            if normal[f] @ normal[g] >= np.cos(np.radians(crease_deg)) - 1e-9:
                for vertex in edge:
                    joined[f, vertex].add((g, vertex))
                    joined[g, vertex].add((f, vertex))
    out = np.empty((len(key), 3, 3))
    for f, face in enumerate(key):
        for k, vertex in enumerate(face):
            group, todo = {f}, [f]
            while todo:
                for g, _ in joined[todo.pop(), vertex]:
                    if g not in group:
                        group.add(g)
                        todo.append(g)
            total = np.zeros(3)
            for g in group:
                at = key[g].index(vertex)
                one = corners[g, (at + 1) % 3] - corners[g, at]
                two = corners[g, (at + 2) % 3] - corners[g, at]
                cosine = one @ two / (np.linalg.norm(one) * np.linalg.norm(two))
                total += np.arccos(np.clip(cosine, -1, 1)) * normal[g]
            out[f, k] = total / np.linalg.norm(total)
    return out


def scene_normals(scene: Scene, normals: str, crease_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Normals of the faces, shape (n_faces, 3), and at their corners, shape (n_faces, 3, 3)."""
    corners = scene.triangles_m
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    if normals == "smooth":
        return flat, smooth_normals(scene, crease_deg)
    return flat, np.repeat(flat[:, None], 3, axis=1)


def curved_points(
    triangles_m: np.ndarray, corner_normals: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Points of the curved surface, shape (n, 3): half the mean of the projections [4]_.

    Triangles and normals have shape (n, 3, 3), `weight` holds barycentric coordinates, (n, 3).
    """
    flat = np.einsum("sk,ska->sa", weight, triangles_m)
    projections = []
    for k in range(3):
        n = corner_normals[:, k]
        above = ((flat - triangles_m[:, k]) * n).sum(axis=1)
        projections.append(flat - above[:, None] * n)
    return 0.5 * flat + 0.5 * np.einsum("sk,ksa->sa", weight, np.array(projections))


def sample_weights(counts: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric coordinates, shape (n, 3), and faces of samples, `counts` of them per face."""
    face = np.repeat(np.arange(len(counts)), counts)
    j = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    jitter = uniform(philox(counters(np.arange(len(face)), 0, 0, 1), seed))[:, 0]
    rotation = philox(counters(face, 0, 0, 2), seed)[:, 0]
    lattice = j.astype(np.uint64) * np.uint64(0x9E3779B9)
    a = (j + jitter) / counts[face]
    b = uniform((lattice + rotation) & np.uint64(0xFFFFFFFF))
    return np.stack([1 - np.sqrt(a), np.sqrt(a) * (1 - b), np.sqrt(a) * b], axis=1), face


def sample_surface(
    scene: Scene, counts: np.ndarray, corner_normals: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points on the flat faces, shading normals, face normals and faces of all samples."""
    weight, face = sample_weights(counts, seed)
    corners = scene.triangles_m[face]
    point = np.einsum("sk,ska->sa", weight, corners)
    shading = np.einsum("sk,ska->sa", weight, corner_normals[face])
    shading /= np.linalg.norm(shading, axis=1, keepdims=True)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return point, shading, flat, face


def curved_samples(
    scene: Scene, counts: np.ndarray, corner_normals: np.ndarray, seed: int
) -> np.ndarray:
    """The points of the same samples on the curved surface, shape (n, 3)."""
    weight, face = sample_weights(counts, seed)
    return curved_points(scene.triangles_m[face], corner_normals[face], weight)


def closest_hit(
    origin: np.ndarray, direction: np.ndarray, triangles_m: np.ndarray, block: int = 64
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Brute force [3]_ over all triangles: distance (inf: none), face (-1: none), u and v."""
    n = len(origin)
    best = np.full(n, np.inf)
    face = np.full(n, -1)
    uv = np.zeros((n, 2))
    # Axis by axis, in blocks that stay in the cache: four times as fast as arrays of vectors.
    v0, v1, v2 = (np.ascontiguousarray(triangles_m[:, k].T) for k in range(3))
    e1, e2 = v1 - v0, v2 - v0
    for at in range(0, n, block):
        part = slice(at, at + block)
        o, d = origin[part].T[:, :, None], direction[part].T[:, :, None]
        p = _cross(d, e2)
        det = _dot(p, e1)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = o - v0[:, None]
            u = _dot(s, p) / det
            q = _cross(s, e1)
            v = _dot(d, q) / det
            t = _dot(q, e2) / det
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        t = np.where(hit, t, np.inf)
        k = t.argmin(axis=1)
        rows = np.arange(len(k))
        found = np.isfinite(t[rows, k])
        best[part] = t[rows, k]
        face[part] = np.where(found, k, -1)
        uv[part, 0] = np.where(found, u[rows, k], 0)
        uv[part, 1] = np.where(found, v[rows, k], 0)
    return best, face, uv


def _cross(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of vectors along the first axis."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: Sequence[np.ndarray] | np.ndarray, b: Sequence[np.ndarray]) -> np.ndarray:
    """Of vectors along the first axis."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def visible(
    point: np.ndarray, normal: np.ndarray, target_m: np.ndarray, triangles_m: np.ndarray
) -> np.ndarray:
    """Whether targets are visible from points on faces, shape (n,)."""
    side = np.sign(np.einsum("sa,sa->s", normal, target_m - point))
    lifted = point + LIFT_M * side[:, None] * normal
    back = target_m - lifted
    reach = np.linalg.norm(back, axis=1)
    return (closest_hit(lifted, back / reach[:, None], triangles_m)[0] >= reach) & (side != 0)


def direction_density(w: np.ndarray, n: np.ndarray, t_m: np.ndarray, alpha: float) -> np.ndarray:
    """Density per solid angle of t_c = normalise(alpha t_d + (1 - alpha) t_m) at unit vectors w.

    t_d = normalise(n + r), r uniform on the unit sphere, has the density max(0, n.t_d) / pi.
    alpha t_d + (1 - alpha) t_m lies on a sphere of radius alpha, which the line s w meets where
    s^2 - 2 s (1 - alpha) w.t_m + (1 - alpha)^2 - alpha^2 = 0; each s > 0 adds
    max(0, n.t_d) / pi x s^2 / (alpha^2 |w.t_d|), the last factor being the area of that sphere per
    solid angle.
    """
    along = (1 - alpha) * (w @ t_m)
    root2 = along**2 - (1 - alpha) ** 2 + alpha**2
    root = np.sqrt(np.maximum(root2, 0))
    total = np.zeros(w.shape[:-1])
    for sign in (-1.0, 1.0):
        s = along + sign * root
        t_d = (s[..., None] * w - (1 - alpha) * t_m) / alpha
        across = np.abs((w * t_d).sum(axis=-1))
        met = (root2 > 0) & (s > 0)
        density = np.maximum(t_d @ n, 0) / np.pi * s**2 / (alpha**2 * np.where(met, across, 1))
        total += np.where(met, density, 0)
    return total


def disc_probability(
    axis: np.ndarray,
    half_angle: float,
    n: np.ndarray,
    face: np.ndarray,
    t_m: np.ndarray,
    alpha: float,
    nodes: int = 24,
) -> float:
    """Integral of the density of t_c over the directions within `half_angle` of `axis`.

    By circles around t_m, on each of which the disc takes an arc. Nodes are dense where the density
    or the length of the arcs has a root or an infinite slope: at the lobe's edge,
    sin beta = alpha / (1 - alpha), and at the disc's. What lies below the face is left out.
    """
    centre = np.arctan2(np.linalg.norm(np.cross(t_m, axis)), t_m @ axis)
    edge = np.arcsin(alpha / (1 - alpha)) if alpha < 0.5 else np.pi
    limits = [abs(centre - half_angle), min(centre + half_angle, np.pi, edge)]
    if centre < half_angle:
        limits.insert(0, 0.0)
    side = axis - (axis @ t_m) * t_m
    if np.linalg.norm(side) < 1e-12:
        side = np.eye(3)[np.argmin(np.abs(t_m))] - t_m[np.argmin(np.abs(t_m))] * t_m
    side /= np.linalg.norm(side)
    x, weight = np.polynomial.legendre.leggauss(nodes)
    tau = (x + 1) * np.pi / 2
    total = 0.0
    for low, high in pairwise(limits):
        high = min(high, edge)
        if high <= low:
            continue
        beta = (low + high) / 2 - (high - low) / 2 * np.cos(tau)
        d_beta = weight * np.pi / 2 * (high - low) / 2 * np.sin(tau)
        cosine = (np.cos(half_angle) - np.cos(beta) * np.cos(centre)) / (
            np.sin(beta) * max(np.sin(centre), 1e-15)
        )
        arc = np.arccos(np.clip(cosine, -1, 1))
        azimuth = arc[:, None] * (np.arange(4 * nodes) + 0.5) / (2 * nodes) - arc[:, None]
        w = (
            np.cos(beta)[:, None, None] * t_m
            + (np.sin(beta)[:, None] * np.cos(azimuth))[..., None] * side
            + (np.sin(beta)[:, None] * np.sin(azimuth))[..., None] * np.cross(t_m, side)
        )
        density = np.where(w @ face > 0, direction_density(w, n, t_m, alpha), 0)
        total += float(np.sum(d_beta * np.sin(beta) * 2 * arc * density.mean(axis=1)))
    return total


def expected(
    scene: Scene,
    array: AntennaArray,
    counts: np.ndarray,
    *,
    reception_radius_m: float = 0.010,
    normals: str = "smooth",
    crease_deg: float = 30.0,
    facets: str = "curved",
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Probability of reception and path length of every sample, Tx and Rx, (n_samples, n_tx, n_rx).

    An Rx is hidden if the centre of its sphere is; if the plane of the sample's face cuts the
    sphere, the middle of the part above it counts instead.
    """
    triangles = scene.triangles_m
    _, corner = scene_normals(scene, normals, crease_deg)
    ground, shading, geometric, face = sample_surface(scene, counts, corner, seed)
    point = curved_samples(scene, counts, corner, seed) if facets == "curved" else ground
    alpha_of = np.asarray(scene.alpha)
    probability = np.zeros((len(point), array.n_tx, array.n_rx))
    to_rx = array.rx_m - point[:, None]
    distance = np.linalg.norm(to_rx, axis=2)
    length = np.linalg.norm(array.tx_m - point[:, None], axis=2)[:, :, None] + distance[:, None]
    for tx, tx_m in enumerate(array.tx_m):
        lit = visible(ground, geometric, np.broadcast_to(tx_m, point.shape), triangles)
        for rx, rx_m in enumerate(array.rx_m):
            g = geometric * -np.sign(np.einsum("sa,sa->s", geometric, ground - tx_m))[:, None]
            height = np.einsum("sa,sa->s", g, rx_m - ground)
            lift = np.clip(reception_radius_m - height, 0, None) / 2
            clear = visible(ground, geometric, rx_m + lift[:, None] * g, triangles)
            reached = lit & clear & (height > -reception_radius_m)
            for s in np.flatnonzero(reached):
                t_i = (point[s] - tx_m) / np.linalg.norm(point[s] - tx_m)
                n = shading[s] * np.sign(shading[s] @ g[s])
                t_m = t_i - 2 * (t_i @ n) * n
                axis, alpha = to_rx[s, rx] / distance[s, rx], float(alpha_of[face[s]])
                half_angle = np.arcsin(reception_radius_m / distance[s, rx])
                if alpha == 0:
                    inside = np.linalg.norm(np.cross(t_m, axis)) < np.sin(half_angle)
                    probability[s, tx, rx] = inside and t_m @ axis > 0 and t_m @ g[s] > 0
                else:
                    probability[s, tx, rx] = disc_probability(axis, half_angle, n, g[s], t_m, alpha)
    return probability, length


def facing(normal: np.ndarray, arrival: np.ndarray) -> np.ndarray:
    """Normals turned against directions."""
    return np.where(np.einsum("sa,sa->s", normal, arrival)[:, None] > 0, -normal, normal)


def outgoing(words: np.ndarray, n: np.ndarray, t_i: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Outgoing directions t_c, shape (n, 3), for random words of the draws."""
    z = 2 * uniform(words)[:, 0] - 1
    angle = 2 * np.pi * (uniform(words)[:, 1] - 0.5)
    ring = np.sqrt(1 - z * z)
    r = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    t_d = (n + r) / np.linalg.norm(n + r, axis=1, keepdims=True)
    t_m = t_i - 2 * np.einsum("sa,sa->s", t_i, n)[:, None] * n
    t_c = alpha[:, None] * t_d + (1 - alpha[:, None]) * t_m
    return t_c / np.linalg.norm(t_c, axis=1, keepdims=True)


def sphere_entry(
    to: np.ndarray, direction: np.ndarray, radius_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Whether rays pass a sphere, `to` its centre, and the distance at which they enter it."""
    along = np.einsum("sa,sa->s", to, direction)
    miss2 = ((to - along[:, None] * direction) ** 2).sum(axis=1)
    half = np.sqrt(np.maximum(radius_m**2 - miss2, 0))
    return (miss2 < radius_m**2) & (along + half > 0), np.maximum(along - half, 0)


def trace(
    scene: Scene,
    array: AntennaArray,
    counts: np.ndarray,
    *,
    rays_per_sample: int = 1,
    reception_radius_m: float = 0.010,
    max_bounces: int = 1,
    normals: str = "smooth",
    crease_deg: float = 30.0,
    facets: str = "curved",
    amplitude: str = "unit",
    pattern_exponent: float = 0.0,
    seed: int = 0,
) -> Paths:
    """Trace `counts` samples per face, shape (n_faces,), by the model of [1]_."""
    triangles = scene.triangles_m
    flat, corner = scene_normals(scene, normals, crease_deg)
    ground, shading, geometric, face_of = sample_surface(scene, counts, corner, seed)
    point = curved_samples(scene, counts, corner, seed) if facets == "curved" else ground
    alpha_of = np.asarray(scene.alpha)
    rows = []
    for tx, tx_m in enumerate(array.tx_m):
        arrival = point - tx_m
        first = np.linalg.norm(arrival, axis=1)
        arrival /= first[:, None]
        lit = visible(ground, geometric, np.broadcast_to(tx_m, point.shape), triangles)
        for ray in range(rays_per_sample):
            sample = np.flatnonzero(lit)
            p, t_i, travelled = point[sample], arrival[sample], first[sample]
            on_face = ground[sample]
            n, g, alpha = shading[sample], geometric[sample], alpha_of[face_of[sample]]
            leaving = arrival[sample, 2]
            for bounce in range(max_bounces):
                g = facing(g, t_i)
                n = facing(n, -g)
                words = philox(counters(sample, tx, ray, 3 | bounce << 8), seed)
                t_c = outgoing(words, n, t_i, alpha)
                up = np.einsum("sa,sa->s", t_c, g) > 0
                sample, p, g, t_c = sample[up], p[up], g[up], t_c[up]
                travelled, leaving, on_face = travelled[up], leaving[up], on_face[up]
                hit, struck, uv = closest_hit(on_face + LIFT_M * g, t_c, triangles)
                for rx, rx_m in enumerate(array.rx_m):
                    passed, entry = sphere_entry(rx_m - p, t_c, reception_radius_m)
                    got = passed & (entry < hit)
                    to = (rx_m - p)[got]
                    segment = np.linalg.norm(to, axis=1)
                    weight = np.ones(len(segment))
                    if amplitude == "spreading":
                        weight = 1 / (travelled[got] * segment)
                        if pattern_exponent > 0:
                            arriving = np.clip(-to[:, 2] / segment, 0, None)
                            both = np.clip(leaving[got], 0, None) * arriving
                            weight = weight * both**pattern_exponent
                    lengths = travelled[got] + segment
                    for s, d, w in zip(sample[got], lengths, weight, strict=True):
                        rows.append((tx, rx, s, ray, bounce + 1, d, w))
                on = struck >= 0
                sample, struck, uv, leaving = sample[on], struck[on], uv[on], leaving[on]
                barycentric = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
                on_face = np.einsum("sk,ska->sa", barycentric, triangles[struck])
                landed = on_face
                if facets == "curved":
                    landed = curved_points(triangles[struck], corner[struck], barycentric)
                t_i = t_c[on]  # of the ray as it was cast, whose origin lies a little above p
                travelled = travelled[on] + np.linalg.norm(landed - p[on], axis=1)
                p = landed
                n = np.einsum("sk,ska->sa", barycentric, corner[struck])
                n /= np.linalg.norm(n, axis=1, keepdims=True)
                g, alpha = flat[struck], alpha_of[struck]
    rows.sort()
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return Paths(
        table[:, 0], table[:, 1], table[:, 5], table[:, 6], table[:, 4], array.n_tx, array.n_rx
    )


def synthesize(paths: Paths, array: AntennaArray, waveform: Waveform) -> np.ndarray:
    """Phasor sum, shape (n_tx, n_rx, n_freq), complex128."""
    out = np.zeros((array.n_tx * array.n_rx, waveform.n_freq), dtype=np.complex128)
    pair = paths.tx.astype(int) * array.n_rx + paths.rx
    for n, f in enumerate(waveform.frequencies_hz):
        phasor = paths.amplitude * np.exp(-2j * np.pi * f / C_M_PER_S * paths.length_m)
        out[:, n] = np.bincount(pair, phasor.real, len(out)) + 1j * np.bincount(
            pair, phasor.imag, len(out)
        )
    return out.reshape(array.n_tx, array.n_rx, waveform.n_freq)


def backproject(
    capture: Capture, points_m: np.ndarray, weights: np.ndarray | None = None
) -> np.ndarray:
    """Image at points, shape (n, 3) metres: shape (n,), complex128."""
    f = capture.waveform.frequencies_hz
    w = np.ones(len(f)) if weights is None else weights
    s = capture.data.astype(np.complex128) * w
    out = np.empty(len(points_m), dtype=np.complex128)
    for i, v in enumerate(points_m):
        to_tx = np.linalg.norm(v - capture.array.tx_m, axis=1)
        to_rx = np.linalg.norm(v - capture.array.rx_m, axis=1)
        tx_phase = np.exp(2j * np.pi / C_M_PER_S * np.outer(f, to_tx))
        rx_phase = np.exp(2j * np.pi / C_M_PER_S * np.outer(f, to_rx))
        # (freq, tx) . (freq, tx, rx) . (freq, rx)
        out[i] = np.einsum("nt,tn->", tx_phase, np.einsum("trn,nr->tn", s, rx_phase))
    return out / s.size


def point_targets(
    array: AntennaArray, waveform: Waveform, points_m: np.ndarray, amplitudes: np.ndarray
) -> Capture:
    """Capture of isotropic point targets, the model that back-projection inverts."""
    k = 2 * np.pi * waveform.frequencies_hz / C_M_PER_S
    s = np.zeros((array.n_tx, array.n_rx, waveform.n_freq), dtype=np.complex128)
    for p, a in zip(np.asarray(points_m), np.asarray(amplitudes), strict=True):
        tx = np.exp(-1j * np.outer(np.linalg.norm(p - array.tx_m, axis=1), k))
        rx = np.exp(-1j * np.outer(np.linalg.norm(p - array.rx_m, axis=1), k))
        s += a * tx[:, None] * rx[None]
    return Capture(s, array, waveform)

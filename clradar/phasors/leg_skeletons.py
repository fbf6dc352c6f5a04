"""Skeleton antennas and frequencies of lit points, chosen from the sums' own terms.

Of the points that all antennas see, the terms vary slowly over antennas (phase relative to the
middle of the cube, distance, angles, pattern), and of all points over frequency; so few of either
give the rest by fixed weights (`clradar.phasors.interpolative`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from clradar.phasors.interpolative import Decomposition, decompose_sampled
from clradar.phasors.leg_tables import NODES, PATTERN_NODES

MIN_SAMPLES = 480
SAMPLES_PER_POINT = 4  # sampled functions per antenna or frequency
CANDIDATES = 4  # points of which the one whose phase varies most is taken
NEAR_POOL, NEAR = 8192, 64
"""Points of which those are picked that are closest to the antennas: drawn as often as all."""


@dataclass(frozen=True, slots=True, eq=False)
class LegPoints:
    """Points as float64 with what their legs need."""

    offset_m: np.ndarray  # (n, 3), from the middle of each point's cube
    centre_m: np.ndarray  # (n, 3), that middle
    area_m2: np.ndarray  # (n, 3)
    slope_m2: np.ndarray  # (n, 3), of `linear_damping`
    level_m2: np.ndarray  # (n,), of `linear_damping`
    material: np.ndarray  # (n,), int

    def __getitem__(self, which: np.ndarray) -> LegPoints:
        return LegPoints(*(getattr(self, f.name)[which] for f in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """The antennas of one side."""

    antennas_m: np.ndarray  # (n, 3), float64, in the frame of the points
    pattern: np.ndarray  # (PATTERN_NODES,): field over sin(angle to the boresight / 2)
    axes: np.ndarray  # (n, 3): boresights

    def lengths_m(self, points: LegPoints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Longer by than from the middle, length, and vectors, (n, n_antennas[, 3]), metres."""
        from_centre = points.centre_m[:, None] - self.antennas_m
        vector = from_centre + points.offset_m[:, None]
        length = np.linalg.norm(vector, axis=2)
        centre = np.linalg.norm(from_centre, axis=2)
        longer = np.einsum("pa,pxa->px", points.offset_m, vector + from_centre) / (length + centre)
        return longer, length, vector

    def terms(
        self, points: LegPoints, k: np.ndarray, m: np.ndarray, tables: np.ndarray
    ) -> np.ndarray:
        """The terms of legs, complex, shape (3, n, n_antennas), each point at its frequency m."""
        longer, length, vector = self.lengths_m(points)
        along = -np.einsum("pxa,pa->px", vector, points.area_m2) / length
        ahead = np.einsum("pxa,xa->px", vector, self.axes)
        half = np.sqrt(np.clip(0.5 - 0.5 * ahead / length, 0.0, 1.0))
        nodes = np.linspace(0.0, 1.0, PATTERN_NODES)
        field = np.interp(half, nodes, self.pattern) / length
        wave = field * np.exp(-2j * np.pi * k[m, None] * longer)
        cosine = along / np.linalg.norm(points.area_m2, axis=1)[:, None]
        g, micro = _of_angle(tables, points.material[:, None], m[:, None], cosine)
        coherent = g * wave * _mean(points, -vector / length[..., None], k[m, None])
        return np.stack([along * coherent, coherent, micro * wave])


def linear_damping(
    edges_m: np.ndarray, towards: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what makes of triangles' second moments M damping of either leg.

    The mean of exp(-j q.x) over a triangle about its centroid is exp(-q.M.q / 2) to second order, q
    = k (s_t + s_r). Its exponent is taken linear in q about k Q, so that it is a sum over legs: k^2
    (s_t + s_r).M.Q - k^2 Q.M.Q / 2. That leaves out k^2 d.M.d / 2, d = s_t + s_r - Q. Q is the mean
    of s_t + s_r along the triangle, shorter by their spread, and 0 where it is less: there some
    pair sees the triangle as a mirror, where the mean is 1 and the sum the largest.

    `edges_m`, (n, 2, 3), are two edges e of each triangle: 18 M = e1 e1 + e2 e2 - (e1 e2 + e2 e1) /
    2; `towards`, (n, 3), is the sum of two unit vectors to the middles of the Tx and the Rx;
    `spread`, (n,), are RMS distances of the antennas from their middles, over the distances of
    those. Returns slope (n, 3) and level (n,), m^2: a leg's share of the exponent is k^2 (slope.s -
    level).
    """
    e1, e2 = edges_m[:, 0].astype(np.float64), edges_m[:, 1].astype(np.float64)
    up = np.cross(e1, e2)
    square = np.einsum("pa,pa->p", up, up)
    across = np.einsum("pa,pa->p", up, towards) ** 2 / np.where(square > 0, square, 1.0)
    along = np.sqrt(np.maximum(np.einsum("pa,pa->p", towards, towards) - across, 1e-12))
    towards = towards * np.maximum(1.0 - spread / along, 0.0)[:, None]
    a, b = (np.einsum("pa,pa->p", e, towards)[:, None] for e in (e1, e2))
    slope_m2 = ((a - 0.5 * b) * e1 + (b - 0.5 * a) * e2) / 18.0
    return slope_m2, 0.25 * np.einsum("pa,pa->p", slope_m2, towards)


def antenna_skeleton(
    points: LegPoints,
    side: Side,
    k: np.ndarray,
    tables: np.ndarray,
    n_terms: int,
    tolerance: float,
) -> Decomposition:
    """Choose the antennas of one side that give the legs to the rest, for points that all see.

    `k`, shape (n_freq,), is in cycles per metre, `tables` has shape (n_materials, n_freq, NODES,
    3), and `tolerance` is the RMS of the error, of every term relative to its RMS over the
    antennas.
    """
    rng = np.random.Generator(np.random.Philox(0))
    n = -(-max(MIN_SAMPLES, SAMPLES_PER_POINT * len(side.antennas_m)) // (3 * n_terms))
    near = _nearest(rng, points, side)

    def draw() -> np.ndarray:
        families = []
        for chosen in (_any(rng, points, n), _hardest(rng, points, side, n), rng.choice(near, n)):
            m = rng.integers(0, len(k), n)
            some = points[chosen]
            terms = side.terms(some, k, m, tables)[:n_terms]
            families += [_normalised(term) for term in terms]
        return np.stack(families)

    return decompose_sampled(draw, tolerance)


def frequency_skeleton(
    points: LegPoints,
    sides: tuple[Side, Side],
    k: np.ndarray,
    tables: np.ndarray,
    n_terms: int,
    tolerance: float,
) -> Decomposition:
    """Choose the frequencies that give the rest: arguments as of `antenna_skeleton`, both sides.

    The choice stays the same where the sides are exchanged.
    """
    sides = min(sides, sides[::-1], key=lambda pair: pair[0].antennas_m.tolist())
    rng = np.random.Generator(np.random.Philox(1))
    n = -(-max(MIN_SAMPLES, SAMPLES_PER_POINT * len(k)) // (2 * (n_terms - 1)))
    offset = k - 0.5 * (k[0] + k[-1])

    def draw() -> np.ndarray:
        families = []
        for hard in (False, True):
            some = points[_any(rng, points, CANDIDATES * n if hard else n)]
            ends, cosines, means = [], [], []
            for side in sides:
                longer, length, vector = side.lengths_m(some)
                one = rng.integers(0, len(side.antennas_m), len(longer))
                if hard:
                    outward = rng.integers(0, 2, len(longer)) == 0
                    one = np.where(outward, longer.argmax(axis=1), longer.argmin(axis=1))
                every = np.arange(len(one))
                ends.append(longer[every, one])
                along = -np.einsum("pa,pa->p", vector[every, one], some.area_m2)
                size = length[every, one] * np.linalg.norm(some.area_m2, axis=1)
                cosines.append(along / size)
                unit = -vector[every, one] / length[every, one, None]
                means.append(_mean(some, unit[:, None], k))
            change = ends[0] + ends[1]
            kept = np.argsort(-np.abs(change), kind="stable")[:n] if hard else np.arange(n)
            wave = np.exp(-2j * np.pi * change[kept, None] * offset)
            material, m = some.material[kept, None], np.arange(len(k))
            legs = [_of_angle(tables, material, m, cosine[kept, None]) for cosine in cosines]
            both = means[0][kept] * means[1][kept]
            for i in range(n_terms - 1):  # coherent, and the incoherent part
                part = legs[0][i] * legs[1][i] * wave
                families.append(_normalised(part if i else part * both))
        return np.stack(families)

    return decompose_sampled(draw, tolerance)


def _any(rng: np.random.Generator, points: LegPoints, n: int) -> np.ndarray:
    return rng.integers(0, len(points.material), n)


def _hardest(rng: np.random.Generator, points: LegPoints, side: Side, n: int) -> np.ndarray:
    """Points whose phase relative to the middle of their cube varies most."""
    some = _any(rng, points, CANDIDATES * n)
    longer = side.lengths_m(points[some])[0]
    return np.asarray(some[np.argsort(-np.ptp(longer, axis=1), kind="stable")[:n]])


def _nearest(rng: np.random.Generator, points: LegPoints, side: Side) -> np.ndarray:
    """Points of some that are closest to antennas, where distances and angles vary most."""
    from scipy.spatial import cKDTree

    some = _any(rng, points, NEAR_POOL)
    at_m = points.centre_m[some] + points.offset_m[some]
    distance_m = cKDTree(side.antennas_m).query(at_m)[0]
    return np.asarray(some[np.argsort(distance_m, kind="stable")[:NEAR]])


def _mean(points: LegPoints, unit: np.ndarray, k: np.ndarray) -> np.ndarray:
    """A leg's part of the mean of the phase over each point's triangle, as in ``kirchhoff.cl``.

    Unit vectors to antennas, shape (n, n_antennas, 3), and cycles per metre, broadcast.
    """
    along = np.einsum("pxa,pa->px", unit, points.slope_m2) - points.level_m2[:, None]
    spread = (2.0 * np.pi * k) ** 2 * along
    return np.asarray(1.0 / (1.0 + spread + 0.5 * spread**2))


def _of_angle(
    tables: np.ndarray, material: np.ndarray, m: np.ndarray, cosine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """g, and the incoherent amplitude, at cosines; materials and frequencies alike, broadcast."""
    at = np.sqrt(np.clip(cosine, 0.0, 1.0)) * (NODES - 1)
    low = np.minimum(at.astype(int), NODES - 2)
    below, above = tables[material, m, low], tables[material, m, low + 1]
    values = below + (at - low)[..., None] * (above - below)
    return values[..., 0] + 1j * values[..., 1], values[..., 2]


def _normalised(values: np.ndarray) -> np.ndarray:
    """Functions of RMS 1 as real and imaginary parts, shape (2 n, n_points); 0 stays 0."""
    rms = np.sqrt(np.mean(np.abs(values) ** 2, axis=1, keepdims=True))
    values = values / np.where(rms > 0, rms, 1.0)
    return np.concatenate([values.real, values.imag])

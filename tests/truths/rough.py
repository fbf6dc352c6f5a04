"""Rough plates: mean field, incoherent power, speckle contrast."""

from dataclasses import dataclass

import numpy as np

from clradar import AntennaArray, Material
from truths import gaussian, measured
from truths.page import Row

F_HZ = measured.band_hz(1)
K = float(measured.wavenumber(F_HZ)[0])
N_WAVES = 512


@dataclass(frozen=True)
class Mean:
    """Echoes of a plate on its axis, one per realisation, over the smooth plate's."""

    g: float
    relative: np.ndarray  # complex, (n_seeds,)
    contrast: float  # of theory

    @property
    def error(self) -> float:
        """Standard error of the mean."""
        return float(self.relative.std() / np.sqrt(len(self.relative)))


def mean_field(g: float, n_seeds: int) -> Mean:
    """A plate of 4 cm at 0.3 m, correlation length 5 mm."""
    side, z, length = 0.04, 0.3, 5e-3
    rms = np.sqrt(g) / (2 * K)
    rough = Material("rough", conductor=True, roughness_rms_m=rms, correlation_length_m=length)
    array = measured.monostatic(np.zeros(3))
    scene = measured.plate((side, side), z)
    smooth = measured.physical(scene, array, F_HZ)[0, 0, 0]
    scene = scene.with_material(rough)
    seeds = range(1, 1 + n_seeds)
    u = [measured.physical(scene, array, F_HZ, seed=seed)[0, 0, 0] for seed in seeds]
    return Mean(g, np.array(u) / smooth, theoretical_contrast(g, side, z, length))


def theoretical_contrast(g: float, side: float, z: float, length: float) -> float:
    """Of Gaussian heights on cells of 1 mm, slopes left out: variance and pseudo-variance of u."""
    x = (np.arange(round(side / 1e-3)) + 0.5) * 1e-3 - side / 2
    px, py = (a.ravel() for a in np.meshgrid(x, x))
    r = np.sqrt(px**2 + py**2 + z**2)
    a = np.exp(-2j * K * r) / r**3
    a = a / a.sum()
    rho = np.exp(-((px[:, None] - px) ** 2 + (py[:, None] - py) ** 2) / length**2)
    variance = a @ (np.exp(-g * (1 - rho)) - np.exp(-g)) @ a.conj()
    pseudo = a @ (np.exp(-g * (1 + rho)) - np.exp(-g)) @ a
    return gaussian.contrast(np.exp(-g), float(variance.real), complex(pseudo))


def contrast(u: np.ndarray) -> float:
    """Standard deviation over mean of the power."""
    power = np.abs(u) ** 2
    return float(power.std() / power.mean())


@dataclass(frozen=True)
class Incoherent:
    """Power of a plate without its mean field, seen from `angle_deg`, dB per area."""

    angle_deg: float
    found: float
    error_db: float  # standard error, dB
    endless: float  # series of the plate without end
    finite: float  # the same plate with its edges
    contrast: float
    samples: int


SIDE_M = 0.04
RANGE_M = 3.0
LENGTH_M = 3e-3


def incoherent(
    rms_m: float,
    angles_deg: tuple[float, ...],
    n_seeds: int,
    n_round: int,
    *,
    across: bool = False,
    side_m: float = SIDE_M,
) -> list[Incoherent]:
    """A plate seen from circles 3 m away around its normal, lit from the same places.

    With `across` it is lit along its normal instead, by one Tx.
    """
    theta = np.repeat(np.radians(angles_deg), n_round)
    phi = np.tile(2 * np.pi * (np.arange(n_round) + 0.5) / n_round, len(angles_deg))
    to = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)], 1)
    at_m = RANGE_M * (to + np.array([0, 0, 1.0]))
    array = AntennaArray(np.zeros((1, 3)), at_m) if across else measured.monostatic(at_m)
    rough = Material("rough", conductor=True, roughness_rms_m=rms_m, correlation_length_m=LENGTH_M)
    scene = measured.plate((side_m, side_m), RANGE_M, material=rough)

    def echoes(seed: int) -> np.ndarray:
        u = measured.physical(scene, array, F_HZ, seed=seed)[:, :, 0]
        return u[0] if across else np.diagonal(u)

    u = np.array([echoes(1 + s) for s in range(n_seeds)])
    away = u - u.mean(axis=0)
    power = (np.abs(away) ** 2).reshape(n_seeds, len(angles_deg), n_round) * n_seeds / (n_seeds - 1)
    sigma0 = 4 * np.pi * RANGE_M**4 * power / side_m**2
    out = []
    for i, angle in enumerate(angles_deg):
        seen = to[i * n_round : (i + 1) * n_round]
        q = K * (seen + (np.array([0, 0, -1.0]) if across else seen))
        own = (K, rms_m, LENGTH_M, (side_m, side_m))
        finite = np.array([gaussian.sigma0_of_rectangle(one, *own) for one in q * [1, 1, -1]])
        # The plate's edges make the power vary around the circle, which is no speckle.
        even = away.reshape(n_seeds, len(angles_deg), n_round)[:, i] / np.sqrt(finite)
        endless = gaussian.sigma0(-q[0, 2], np.hypot(q[0, 0], q[0, 1]), K, rms_m, LENGTH_M)
        mean = sigma0[:, i].mean()
        error = sigma0[:, i].mean(axis=1).std() / np.sqrt(n_seeds) / mean
        mean_db, endless_db, finite_db = 10 * np.log10([mean, endless, finite.mean()])
        spread = contrast(even.ravel())
        out.append(
            Incoherent(angle, mean_db, 4.343 * error, endless_db, finite_db, spread, n_seeds)
        )
    return out


def mean_rows(means: list[Mean]) -> list[Row]:
    """|<u>/u_0 - exp(-g/2)| within three standard errors."""
    out = []
    for m in means:
        truth = float(gaussian.coherent(np.array(m.g)))
        shift = abs(complex(m.relative.mean()) - truth)
        case = f"g = {m.g:g}: exp(-g/2) = {truth:.3f}, found {abs(m.relative.mean()):.3f}"
        out.append(Row(case, 0, shift, 3 * m.error, "", 3, at_most=True))
    return out


def contrast_rows(means: list[Mean]) -> list[Row]:
    """Within three standard errors of a contrast, about (C + C^2)/sqrt(n) for n realisations.

    With (C + C^2)/sqrt(n): an exponential power, C = 1, has C sqrt(2/n), and a normal one
    C/sqrt(2 n).
    """
    out = []
    for m in means:
        c = m.contrast
        bound = 3 * (c + c * c) / np.sqrt(len(m.relative))
        out.append(Row(f"specular, g = {m.g:g}", c, contrast(m.relative), bound, ""))
    return out


def incoherent_rows(found: list[Incoherent]) -> list[Row]:
    """0.2 dB, or three standard errors where realisations are few."""
    return [Row(f"{i.angle_deg:g}°", i.finite, i.found, max(0.2, 3 * i.error_db)) for i in found]


def speckle_rows(found: list[Incoherent]) -> list[Row]:
    """Contrast 1 away from the specular direction, where no mean field is left.

    The bound is three standard errors, C sqrt(2/n), with the realisations times the looks of a
    circle that are independent, 2 k sin(angle) side / pi of them, and half the contrast of K that
    the sample mean leaves.
    """
    out = []
    for i in found:
        looks = max(1.0, 2 * K * np.sin(np.radians(i.angle_deg)) * SIDE_M / np.pi)
        bound = 3 * 2 / np.sqrt(i.samples * min(looks, 24))
        out.append(Row(f"{i.angle_deg:g}°", 1.0, i.contrast, bound, ""))
    return out

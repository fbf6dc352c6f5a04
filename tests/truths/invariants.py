"""Reciprocity, energy, independence of the density."""

import numpy as np

import clradar
from clradar import AntennaArray, Capture, Material, Scene, VoxelGrid, Waveform
from truths import measured, optics
from truths.page import Row

PALM = Material(
    "rough skin", permittivity=6.56 - 8.91j, roughness_rms_m=0.15e-3, correlation_length_m=3e-3
)


def directions(n: int) -> np.ndarray:
    """Fibonacci's lattice on the unit sphere, shape (n, 3)."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    ring, angle = np.sqrt(1 - z**2), np.pi * (1 + np.sqrt(5)) * i
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def returned_share(scene: Scene, solid_angle: float, n_rx: int) -> float:
    """Power through a sphere of receivers around the target over the power that falls on it.

    The wave of one Tx falls on the solid angle that the target fills; |u|^2 is the power per area
    where the wave has 1/R^2.
    """
    distance, reach = 0.3, 1.0
    rx_m = reach * directions(n_rx) + np.array([0, 0, distance])
    u = measured.physical(scene, AntennaArray(np.zeros((1, 3)), rx_m), measured.band_hz(1))[0, :, 0]
    return float(np.mean(np.abs(u) ** 2) * 4 * np.pi * reach**2 / solid_angle)


def reciprocity(scene: Scene, rng: np.random.Generator) -> float:
    """Largest difference when Tx and Rx change places, over the largest value, dB."""
    tx_m, rx_m = (np.column_stack([rng.uniform(-0.07, 0.07, (n, 2)), np.zeros(n)]) for n in (6, 7))
    f = measured.band_hz(5)
    there = measured.physical(scene, AntennaArray(tx_m, rx_m), f)
    back = measured.physical(scene, AntennaArray(rx_m, tx_m), f)
    difference = np.abs(there - back.transpose(1, 0, 2)).max() / np.abs(there).max()
    return float(20 * np.log10(max(difference, 1e-12)))


def image(scene: Scene, density: float, array: AntennaArray, n_freq: int) -> np.ndarray:
    f = measured.band_hz(n_freq)
    u = measured.physical(scene, array, f, samples_per_mm2=density)
    # Whole voxels from the scene's lowest corner to beyond its highest.
    low, size = scene.vertices_m.min(axis=0) - 5e-3, np.ptp(scene.vertices_m, axis=0) + 10e-3
    high = low + 2e-3 * np.ceil(size / 2e-3)
    grid = VoxelGrid.from_extent(*zip(low, high, strict=True), spacing_m=2e-3)
    return clradar.backproject(Capture(u, array, Waveform(f)), grid).data


def density_errors(
    scene: Scene,
    densities: tuple[float, ...],
    array: AntennaArray,
    n_freq: int,
) -> np.ndarray:
    """RMS difference of each image to that of the last density, dB."""
    images = [image(scene, d, array, n_freq) for d in densities]
    truth = images[-1]
    return np.array(
        [20 * np.log10(np.linalg.norm(i - truth) / np.linalg.norm(truth)) for i in images[:-1]]
    )


ENERGY_CASES = tuple(
    f"{shape}, {surface}"
    for surface in ("metal", "rough metal", "skin", "rough skin")
    for shape in ("ball", "plate")
)
ENERGY_BOUND = 1.0
"""No passive surface returns more than falls on it."""
OWN_ENERGY_BOUND = 0.01
"""Both have jagged shadows: the integral changes by 0.002 from 160 to 240 nodes, and the ball of
faces of 1.6 mm by 1 % of its area at grazing angles."""
DENSITY_BOUND_DB = -38.0
RECIPROCITY_BOUND_DB = -100.0
"""float32: sums of some thousand terms lose less than 2^-24 sqrt(1000) of the largest value."""


def energy_rows(n_rx: int, cases: tuple[str, ...] = ENERGY_CASES) -> list[Row]:
    """A ball of 8 mm and a plate of 3 cm, smooth and rough, of metal and of skin."""
    rough = {"roughness_rms_m": 0.3e-3, "correlation_length_m": 3e-3}
    skin = {"permittivity": 6.56 - 8.91j}
    metal: dict[str, bool] = {"conductor": True}
    fields = {"metal": metal, "rough metal": metal | rough}
    fields |= {"skin": skin, "rough skin": skin | rough}
    out = []
    for case in cases:
        shape, surface = case.split(", ")
        material = Material(surface, **fields[surface])
        if shape == "ball":
            scene = measured.ball(8e-3, 0.3, 1.6e-3, material)
            angle = 2 * np.pi * (1 - np.sqrt(1 - (8e-3 / 0.3) ** 2))
        else:
            scene = measured.plate((0.03, 0.03), 0.3, material=material)
            angle = 4 * np.arctan(0.015**2 / (0.3 * np.sqrt(0.09 + 2 * 0.015**2)))
        share = returned_share(scene, angle, n_rx)
        out.append(Row(case, 0, share, ENERGY_BOUND, "", 3, at_most=True))
    return out


def own_energy_row(found: float, nodes: int = 160) -> Row:
    """The metal ball against the approximation itself on an exact sphere."""
    k = float(measured.wavenumber(measured.band_hz(1))[0])
    own = optics.sphere_returned_share(0.3, 8e-3, 1.0, k, nodes)
    case = "ball, metal, against the approximation's own integral"
    return Row(case, own, found, OWN_ENERGY_BOUND, "", 3)


def reciprocity_rows(scenes: dict[str, Scene]) -> list[Row]:
    rng = np.random.default_rng(1)
    return [
        Row(name, 0, reciprocity(scene, rng), RECIPROCITY_BOUND_DB, "dB", 0, at_most=True)
        for name, scene in scenes.items()
    ]

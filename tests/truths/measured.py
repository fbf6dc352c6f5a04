"""What clradar gives for the scenes of `checks`: S-parameters as echoes u, 1/m."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh

import clradar
from clradar import AntennaArray, Material, Scene, Waveform
from clradar.reference import kirchhoff
from clradar.tracing.quadrature import LitPoints, LitQuadrature
from clradar.tracing.settings import resolve_settings

C_M_PER_S = 299_792_458.0

Simulator = Callable[..., np.ndarray]
"""(scene, array, frequencies_hz, seed=0, samples_per_mm2=4.0) to u, shape (n_tx, n_rx, n_freq)."""


def band_hz(n: int) -> np.ndarray:
    """Frequencies of the imager's band; one: its middle."""
    return np.linspace(72e9, 82e9, n) if n > 1 else np.array([77e9])


def wavenumber(frequencies_hz: np.ndarray) -> np.ndarray:
    return 2 * np.pi * frequencies_hz / C_M_PER_S


def monostatic(at_m: np.ndarray) -> AntennaArray:
    """Tx and Rx at the same places, shape (n, 3)."""
    return AntennaArray(np.atleast_2d(at_m), np.atleast_2d(at_m))


def echo(data: np.ndarray, frequencies_hz: np.ndarray) -> np.ndarray:
    """S-parameters to u: s = lambda / (4 pi) u for isotropic antennas."""
    return data.astype(complex) * (4 * np.pi * frequencies_hz / C_M_PER_S)


def physical(
    scene: Scene,
    array: AntennaArray,
    frequencies_hz: np.ndarray,
    *,
    seed: int = 0,
    samples_per_mm2: float = 4.0,
) -> np.ndarray:
    """By `clradar.simulate(..., estimator="physical")`."""
    settings = {"estimator": "physical", "samples_per_mm2": samples_per_mm2, "seed": seed}
    capture = clradar.simulate(scene, array, Waveform(frequencies_hz), **settings)
    return echo(capture.data, frequencies_hz)


def reference(
    scene: Scene,
    array: AntennaArray,
    frequencies_hz: np.ndarray,
    *,
    seed: int = 0,
    samples_per_mm2: float = 4.0,
) -> np.ndarray:
    """By `clradar.reference.kirchhoff`, for scenes of one material."""
    material = scene.materials[0]
    corners = scene.triangles_m
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area_mm2 = np.linalg.norm(across, axis=1) / 2 * 1e6
    cuts = np.maximum(1, np.ceil(np.sqrt(area_mm2 * samples_per_mm2))).astype(int)
    smooth = kirchhoff.quadrature(scene, cuts)
    seen = [kirchhoff.seen_side(smooth, scene, at_m) for at_m in (array.tx_m, array.rx_m)]
    surface, *sides = kirchhoff.towards_antennas(smooth, *seen)
    if material.roughness_rms_m > 0:
        length_m = material.correlation_length_m
        assert length_m is not None
        rough = (material.roughness_rms_m, length_m, seed, material.name)
        surface = kirchhoff.roughened(surface, *rough)
    legs: list[np.ndarray | float] = [1.0, 1.0]
    if not material.conductor:
        eps = material.permittivity_at(frequencies_hz)
        unit = surface.area_m2 / np.linalg.norm(surface.area_m2, axis=1, keepdims=True)
        for i, at_m in enumerate((array.tx_m, array.rx_m)):
            to = at_m - surface.point_m[:, None]
            cosine = np.abs(np.einsum("pxa,pa->px", to, unit)) / np.linalg.norm(to, axis=2)
            legs[i] = kirchhoff.leg(eps, np.minimum(cosine, 1))
    data = kirchhoff.kirchhoff(
        surface, array, frequencies_hz, *sides, tx_leg=legs[0], rx_leg=legs[1]
    )
    return echo(data, frequencies_hz)


def lit_points(scene: Scene, array: AntennaArray, **fields: object) -> LitPoints:
    """The points of the physical estimator, in the antenna frame, float64."""
    settings = resolve_settings(estimator="physical", **fields)
    with LitQuadrature(scene, array, settings, clradar.open_device("pocl")) as quadrature:
        lit = quadrature.lit_points()
        position_m = lit.position_m.astype(float) + quadrature.middle_m
        return replace(lit, position_m=position_m, area_m2=lit.area_m2.astype(float))


def ball(radius_m: float, z_m: float, edge_m: float, material: Material | None = None) -> Scene:
    """Icosphere whose edges are at most about `edge_m` long."""
    subdivisions = 1
    while 1.1 * radius_m / 2**subdivisions > edge_m:
        subdivisions += 1
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m)
    mesh.apply_translation([0, 0, z_m])
    scene = Scene.from_mesh(mesh)
    return scene if material is None else scene.with_material(material)


def plate(
    sides_m: tuple[float, float],
    z_m: float,
    tilt_rad: float = 0.0,
    material: Material | None = None,
) -> Scene:
    """Rectangle of two triangles around (0, 0, z), tilted about y."""
    a, b = sides_m[0] / 2, sides_m[1] / 2
    x = np.array([-a, a, a, -a])
    y = np.array([-b, -b, b, b])
    vertices = np.stack([x * np.cos(tilt_rad), y, z_m + x * np.sin(tilt_rad)], axis=1)
    scene = Scene(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    return scene if material is None else scene.with_material(material)


def disc(radius_m: float, z_m: float, corners: int = 256) -> Scene:
    """Regular polygon of the disc's area around (0, 0, z)."""
    angle = 2 * np.pi * np.arange(corners) / corners
    size = radius_m * np.sqrt(2 * np.pi / (corners * np.sin(2 * np.pi / corners)))
    rim = np.stack([size * np.cos(angle), size * np.sin(angle), 0 * angle], axis=1)
    vertices = np.vstack([np.zeros(3), rim]) + np.array([0, 0, z_m])
    i = np.arange(corners)
    faces = np.stack([0 * i, 1 + i, 1 + (i + 1) % corners], axis=1)
    return Scene(vertices, faces)

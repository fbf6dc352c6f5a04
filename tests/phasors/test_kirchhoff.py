"""The physical estimator against the float64 sum over its own points, and against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model.material_file import material_of
from clradar.opencl import open_device
from clradar.phasors.kirchhoff_sum import TOLERANCE_DB
from clradar.tracing.quadrature import LitPoints, LitQuadrature
from clradar.tracing.settings import resolve_settings

FULL = clradar.arrays.qar50()
ARRAY = clradar.AntennaArray(FULL.tx_m[::5], FULL.rx_m[::4])  # 19 x 24: odd against 8 lanes
WAVEFORM = clradar.Waveform(np.linspace(72e9, 82e9, 23))
SKIN = clradar.Material("skin", permittivity=6.56 - 8.91j)


def plate(side_m: float, z_m: float, tilt_deg: float = 0.0) -> clradar.Scene:
    a = side_m / 2
    corners = np.array([[-a, -a, 0], [a, -a, 0], [a, a, 0], [-a, a, 0]])
    turned = trimesh.transformations.rotation_matrix(np.radians(tilt_deg), [0, 1, 0])
    corners = corners @ turned[:3, :3].T + [0, 0, z_m]
    return clradar.Scene(corners, [[0, 1, 2], [0, 2, 3]])


def ball_before_plate() -> clradar.Scene:
    """A ball that hides a part of a tilted plate."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.012)
    ball.apply_translation([0.005, 0.0, 0.26])
    return clradar.Scene.combine([clradar.Scene.from_mesh(ball), plate(0.05, 0.29, 20.0)])


def db(got: np.ndarray, want: np.ndarray) -> float:
    return float(20 * np.log10(np.linalg.norm(got - want) / np.linalg.norm(want)))


def lit_points(scene: clradar.Scene, array: clradar.AntennaArray, **fields: object) -> LitPoints:
    """The points, their positions in the antenna frame."""
    settings = resolve_settings(estimator="physical", **fields)
    with LitQuadrature(scene, array, settings, open_device("pocl")) as quadrature:
        lit = quadrature.lit_points()
        return replace(lit, position_m=lit.position_m + quadrature.middle_m.astype(np.float64))


def dense(
    lit: LitPoints,
    array: clradar.AntennaArray,
    waveform: clradar.Waveform,
    materials: tuple[clradar.Material, ...] = (),
) -> np.ndarray:
    """The sum over lit points in float64, term by term."""
    area = np.linalg.norm(lit.area_m2.astype(float), axis=1)[:, None]
    sides = []
    for at_m, bits in ((array.tx_m, lit.tx), (array.rx_m, lit.rx)):
        seen = np.unpackbits(bits, axis=1, bitorder="little")[:, : len(at_m)]
        to = at_m - lit.position_m[:, None]
        length = np.linalg.norm(to, axis=2)
        along = np.einsum("pxa,pa->px", to, lit.area_m2.astype(float)) / length
        sides.append((length, along, seen / length))
    out = np.empty((array.n_tx, array.n_rx, waveform.n_freq), complex)
    for m, f in enumerate(waveform.frequencies_hz):
        k = 2 * np.pi * f / SPEED_OF_LIGHT_M_PER_S
        waves = []
        for length, along, field in sides:
            wave = field * np.exp(-1j * k * length)
            for index, material in enumerate(materials):
                mine = lit.material == index
                cosine = np.clip(along[mine] / area[mine], 0, 1)
                gamma = material.reflection([f], cosine.ravel()).reshape(cosine.shape)
                wave[mine] *= np.sqrt(-gamma)
            waves.append(wave)
        (_, tx_along, _), (_, rx_along, _) = sides
        out[:, :, m] = (waves[0] * tx_along).T @ waves[1] + waves[0].T @ (waves[1] * rx_along)
    return -1j / (8 * np.pi) * out


@pytest.mark.parametrize("width", [8, 1])
def test_shadowed_scene_of_skin_and_metal(width: int) -> None:
    materials = {"mesh": SKIN, "mesh-2": "metal"}
    scene = ball_before_plate().with_material(materials)
    device = open_device("pocl", width=width)
    capture = clradar.simulate(scene, ARRAY, WAVEFORM, estimator="physical", device=device)
    lit = lit_points(scene, ARRAY)
    want = dense(lit, ARRAY, WAVEFORM, scene.materials)
    assert db(capture.data, want) < TOLERANCE_DB
    facts = capture.meta["kirchhoff"]
    assert 0 < facts["seen_by_all"] < facts["lit"] == len(lit.sample)
    assert facts["skeleton_tx"] < ARRAY.n_tx
    assert facts["skeleton_frequencies"] < WAVEFORM.n_freq
    recorded = capture.meta["scene"]["materials"]
    assert [material_of(record) for record in recorded] == list(scene.materials)
    assert capture.meta["absolute"]


def test_flat_plate_in_the_far_field() -> None:
    """4 pi A^2 / lambda^2, and the phase -k 2 R - pi/2, less k a^2 / (6 R) = 0.0224 rad at 30 m,
    the mean of k (x^2 + y^2) / R, whose spread costs 0.001 dB."""
    waveform = clradar.Waveform([77e9])
    one = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / 77e9
    s = clradar.simulate(plate(0.05, 30.0), one, waveform, estimator="physical").data[0, 0, 0]
    sigma_m2 = (4 * np.pi) ** 3 * 30.0**4 / wavelength_m**2 * abs(s) ** 2
    want_m2 = 4 * np.pi * 0.05**4 / wavelength_m**2
    assert 10 * np.log10(sigma_m2 / want_m2) == pytest.approx(0.0, abs=0.01)
    turned = np.angle(s * np.exp(2j * np.pi * 60.0 / wavelength_m))
    assert turned == pytest.approx(-np.pi / 2 - 0.0224, abs=1e-3)


def test_exchange_of_tx_and_rx_transposes_the_capture() -> None:
    scene = ball_before_plate().with_material(SKIN)
    other = clradar.AntennaArray(ARRAY.rx_m, ARRAY.tx_m)
    one, two = (
        clradar.simulate(scene, array, WAVEFORM, estimator="physical") for array in (ARRAY, other)
    )
    assert db(two.data, one.data.transpose(1, 0, 2)) < -95

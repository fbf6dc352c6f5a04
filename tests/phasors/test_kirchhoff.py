"""The physical estimator against the float64 sum over its own points, and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from nightly import nightly
from scipy.integrate import trapezoid
from truths import measured
from truths.measured import lit_points

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model.material_file import material_of
from clradar.phasors.kirchhoff_sum import TOLERANCE_DB
from clradar.phasors.leg_tables import NODES, reflection_legs
from clradar.tracing.quadrature import LitPoints

FULL = clradar.arrays.qar50()
ARRAY = clradar.AntennaArray(FULL.tx_m[::5], FULL.rx_m[::4])  # 19 x 24: odd against 8 lanes
WAVEFORM = clradar.Waveform(np.linspace(72e9, 82e9, 23))
ROUGH = clradar.Material(
    "rough", conductor=True, roughness_rms_m=0.05e-3, correlation_length_m=1e-3
)
SPARSE = 1.5
"""Points per square millimetre."""
SKIN = clradar.Material("skin", permittivity=6.56 - 8.91j)


def ball_before_plate() -> clradar.Scene:
    """A ball that hides a part of a tilted plate."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.012)
    ball.apply_translation([0.005, 0.0, 0.26])
    return clradar.Scene.combine(
        [clradar.Scene.from_mesh(ball), measured.plate((0.05, 0.05), 0.29, np.radians(20.0))]
    )


def db(got: np.ndarray, want: np.ndarray) -> float:
    return float(20 * np.log10(np.linalg.norm(got - want) / np.linalg.norm(want)))


def simulated(
    scene: clradar.Scene, array: clradar.AntennaArray, device: clradar.Device | str = "pocl"
) -> clradar.Capture:
    """At the least density that is not warned of, for quick sums in float64."""
    return clradar.simulate(
        scene, array, WAVEFORM, estimator="physical", samples_per_mm2=SPARSE, device=device
    )


def dense(
    lit: LitPoints,
    array: clradar.AntennaArray,
    waveform: clradar.Waveform,
    materials: tuple[clradar.Material, ...] = (),
) -> np.ndarray:
    """The sum over lit points in float64, term by term, with the array's patterns and the mean of
    the phase over the points' triangles."""
    patterns = [p or clradar.AntennaPattern() for p in (array.tx_pattern, array.rx_pattern)]
    area = np.linalg.norm(lit.area_m2.astype(float), axis=1)[:, None]
    both = ((array.tx_m, lit.tx, patterns[0]), (array.rx_m, lit.rx, patterns[1]))
    towards, spread = np.zeros((len(area), 3)), np.zeros((len(area), 1))
    for at_m, bits, _ in both:
        seen = np.unpackbits(bits, axis=1, bitorder="little")[:, : len(at_m)]
        to = seen @ at_m / seen.sum(axis=1, keepdims=True) - lit.position_m
        distance = np.linalg.norm(to, axis=1, keepdims=True)
        towards += to / distance
        spread += np.linalg.norm(at_m - at_m.mean(axis=0)) / np.sqrt(len(at_m)) / distance
    e1, e2 = lit.edges_m.astype(float).swapaxes(0, 1)
    normal = np.cross(e1, e2)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    towards -= np.einsum("pa,pa->p", towards, normal)[:, None] * normal
    towards *= np.maximum(1 - spread / np.linalg.norm(towards, axis=1, keepdims=True), 0)
    corners = np.stack([-e1 - e2, 2 * e1 - e2, 2 * e2 - e1]) / 3  # about the centroid
    slope = np.einsum("cpa,cpb,pb->pa", corners, corners, towards) / 12
    level = np.einsum("pa,pa->p", slope, towards)[:, None] / 4
    sides = []
    for at_m, bits, pattern in both:
        seen = np.unpackbits(bits, axis=1, bitorder="little")[:, : len(at_m)]
        to = at_m - lit.position_m[:, None]
        length = np.linalg.norm(to, axis=2)
        along = np.einsum("pxa,pa->px", to, lit.area_m2.astype(float)) / length
        field = seen * pattern.amplitude(-to[..., 2] / length) / length
        sides.append((length, along, field, np.einsum("pxa,pa->px", to, slope) / length - level))
    out = np.empty((array.n_tx, array.n_rx, waveform.n_freq), complex)
    for m, f in enumerate(waveform.frequencies_hz):
        k = 2 * np.pi * f / SPEED_OF_LIGHT_M_PER_S
        waves = []
        for length, along, field, moment in sides:
            part = k**2 * moment
            wave = field * np.exp(-1j * k * length) / (1 + part + part**2 / 2)
            for index, material in enumerate(materials):
                mine = lit.material == index
                cosine = np.clip(along[mine] / area[mine], 0, 1)
                wave[mine] *= root(material, f, cosine)
            waves.append(wave)
        (_, tx_along, *_), (_, rx_along, *_) = sides
        out[:, :, m] = (waves[0] * tx_along).T @ waves[1] + waves[0].T @ (waves[1] * rx_along)
    return -1j / (8 * np.pi) * out


def root(material: clradar.Material, f: float, cosine: np.ndarray) -> np.ndarray:
    """sqrt(-Gamma), continuous from normal incidence on."""
    grid = np.linspace(1.0, 1e-4, 4000)
    gamma = material.reflection([f], grid)[0]
    phase = np.interp(-cosine, -grid, np.unwrap(np.angle(-gamma)))
    return np.sqrt(np.interp(-cosine, -grid, np.abs(gamma))) * np.exp(0.5j * phase)


def test_a_coat_whose_reflection_depends_on_angle_and_frequency():
    """2 mm with hardly any loss, at 60 degrees: of metal nothing but the coat is a material."""
    coat = clradar.Coating(2e-3, 6 - 0.1j)
    scene = measured.plate((0.05, 0.05), 0.29, np.radians(60.0)).with_material(
        clradar.Material("coated metal", conductor=True, coating=coat)
    )
    capture = simulated(scene, ARRAY)
    lit = lit_points(scene, ARRAY, samples_per_mm2=SPARSE)
    some = clradar.Waveform(WAVEFORM.frequencies_hz[::3])
    want = dense(lit, ARRAY, some, scene.materials)
    assert db(capture.data[:, :, ::3], want) < TOLERANCE_DB


def test_shadowed_scene_of_skin_and_metal():
    materials = {"mesh": SKIN, "mesh-2": "metal"}
    scene = ball_before_plate().with_material(materials)
    capture = simulated(scene, ARRAY)
    lit = lit_points(scene, ARRAY, samples_per_mm2=SPARSE)
    some = clradar.Waveform(WAVEFORM.frequencies_hz[::11])
    want = dense(lit, ARRAY, some, scene.materials)
    assert db(capture.data[:, :, ::11], want) < TOLERANCE_DB
    facts = capture.meta["kirchhoff"]
    assert 0 < facts["seen_by_all"] < facts["lit"] == len(lit.sample)
    seen = [np.unpackbits(bits, axis=1).sum(axis=1, dtype=int) for bits in (lit.tx, lit.rx)]
    assert capture.meta["rays"]["paths"] == (seen[0] * seen[1]).sum()
    assert facts["skeleton_tx"] < ARRAY.n_tx
    assert facts["skeleton_frequencies"] < WAVEFORM.n_freq
    recorded = capture.meta["scene"]["materials"]
    assert [material_of(record) for record in recorded] == list(scene.materials)
    assert capture.meta["absolute"]


def test_what_reflects_nothing_gives_zeros():
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.02 + [0, 0, 0.3]
    air = clradar.Material("air", permittivity=1.0)
    scene = clradar.Scene(corners, [[0, 2, 1], [0, 3, 2]]).with_material(air)
    array = clradar.AntennaArray(FULL.tx_m[::24], FULL.rx_m[::31])
    got = clradar.simulate(scene, array, WAVEFORM, estimator="physical").data
    assert not got.any()


def test_patterns_of_antennas():
    """cos^2 for Tx, and a table for Rx that is zero beyond 40 degrees."""
    tx = clradar.AntennaPattern(gain_dbi=6.0, exponent=2.0)
    rx = clradar.AntennaPattern(angle_deg=[0, 20, 40, 180], field=[1, 0.8, 0, 0])
    array = clradar.AntennaArray(ARRAY.tx_m, ARRAY.rx_m, tx_pattern=tx, rx_pattern=rx)
    scene = measured.plate((0.06, 0.06), 0.1)
    lit = lit_points(scene, array, samples_per_mm2=SPARSE)
    got = simulated(scene, array).data[:, :, ::11]
    some = clradar.Waveform(WAVEFORM.frequencies_hz[::11])
    assert db(got, dense(lit, array, some)) < TOLERANCE_DB


def test_micro_roughness_damps_and_scatters_what_it_takes():
    """The mean over seeds is exp(-g/2) of the smooth plate, g = 4 k^2 h_u^2, and what is scattered
    has the power of the formula. 16 seeds: the variance of a pair and frequency is known to 35 %,
    and 24 pairs and frequencies, of which some are alike, give about 9 %."""
    rms_m = 0.15e-3
    waveform = clradar.Waveform([72e9, 82e9])
    array = clradar.AntennaArray(ARRAY.tx_m[::6], ARRAY.rx_m[::8])
    scene = measured.plate((0.02, 0.02), 0.3)
    smooth = clradar.simulate(scene, array, waveform, estimator="physical", samples_per_mm2=1.5)
    material = clradar.Material("micro", conductor=True, micro_roughness_rms_m=rms_m)
    rough = scene.with_material(material)
    data = np.array([
        clradar.simulate(
            rough, array, waveform, estimator="physical", samples_per_mm2=1.5, seed=seed
        ).data
        for seed in range(16)
    ])  # fmt: skip
    k = 2 * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    g = 4 * (k * rms_m) ** 2
    # At 15 degrees cos^2 is 0.93; where the plate mirrors, both angles are the same.
    ratio = np.einsum("tri,tri->i", data.mean(axis=0), smooth.data.conj()) / np.einsum(
        "tri,tri->i", smooth.data, smooth.data.conj()
    )
    assert np.abs(ratio) == pytest.approx(np.exp(-g / 2), rel=0.06)
    # sigma0 w / (4 pi R^4) per point, u to s by lambda / (4 pi); R = 0.3 to 0.32 m.
    lit = lit_points(scene, array, samples_per_mm2=1.5)
    power = np.zeros((array.n_tx, array.n_rx, 2))
    legs = []
    for at_m in (array.tx_m, array.rx_m):
        to = at_m - lit.position_m[:, None]
        length = np.linalg.norm(to, axis=2)
        legs.append((length, -to[..., 2] / length))
    for i, number in enumerate(k):
        share = [-np.expm1(-4 * (number * rms_m * c) ** 2) for _, c in legs]
        cosine = np.linspace(0, 1, 2001)
        lost = -np.expm1(-4 * (number * rms_m * cosine) ** 2)
        mean = 2 * np.mean((lost * cosine)[1:])
        sides = [s * c / r**2 for s, (r, c) in zip(share, legs, strict=True)]
        area_m2 = np.linalg.norm(lit.area_m2, axis=1)
        sigma = 4 * np.einsum("p,pt,pr->tr", area_m2, *sides) / mean
        power[:, :, i] = sigma / (4 * np.pi) / (2 * number) ** 2
    assert data.var(axis=0).mean() == pytest.approx(power.mean(), rel=0.15)


def test_micro_roughness_keeps_the_energy():
    """What the incoherent part sends to all directions is what the mirror direction lost."""
    material = clradar.material("palm")
    micro = replace(material, micro_roughness_rms_m=0.2e-3)
    table = reflection_legs([micro], np.array([77e9]))[0, 0]
    cosine = np.linspace(0, 1, NODES) ** 2
    k = 2 * np.pi * 77e9 / SPEED_OF_LIGHT_M_PER_S
    square = table[:, 2] ** 2 * k / (4 * np.pi)
    scattered = 2 * square[1:] / cosine[1:] * trapezoid(square, cosine)
    reflected = np.abs(material.reflection([77e9], cosine[1:])[0]) ** 2
    lost = reflected * -np.expm1(-4 * (k * 0.2e-3 * cosine[1:]) ** 2)
    assert scattered == pytest.approx(lost, rel=1e-3)


def test_sparse_points_are_warned_of():
    waveform = clradar.Waveform([77e9])
    for material, density in (("metal", 0.9), (ROUGH, 3.0)):
        scene = measured.plate((0.005, 0.005), 0.3).with_material(material)
        with pytest.warns(clradar.ClradarWarning, match="too far for .*; take at least"):
            clradar.simulate(scene, ARRAY, waveform, estimator="physical", samples_per_mm2=density)


@pytest.mark.parametrize("seed", [0, *nightly(range(1, 5))])
def test_drawn_arrays_bands_and_scenes_keep_the_tolerance(seed):
    """From 2 Tx to 100 of lines, planes or clouds of 5 to 60 wavelengths, one frequency to 40 of
    bands of 1 % to 20 %, a ball before a box from a third to three apertures away."""
    rng = np.random.default_rng(seed)
    high_hz = rng.uniform(10e9, 90e9)
    low_hz = high_hz * (1 - 10 ** rng.uniform(-2, -0.7))
    waveform = clradar.Waveform(np.sort(rng.uniform(low_hz, high_hz, rng.integers(1, 41))))
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / high_hz
    aperture_m = wavelength_m * 10 ** rng.uniform(0.7, 1.8)
    flat = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1]])[rng.integers(3)]
    sides = [
        aperture_m * flat * rng.uniform(-0.5, 0.5, (rng.integers(2, 101), 3)) for _ in range(2)
    ]
    array = clradar.AntennaArray(*sides)
    away_m = aperture_m * (0.5 * flat[2] + 10 ** rng.uniform(-0.5, 0.5))
    radius_m = wavelength_m * 10 ** rng.uniform(0, 0.6)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius_m)
    ball.apply_translation([*rng.uniform(-0.5, 0.5, 2) * away_m, away_m + radius_m])
    box = trimesh.creation.box([2 * radius_m, radius_m, 0.2 * radius_m])
    box.apply_translation([*rng.uniform(-1, 1, 2) * radius_m, away_m + 2.5 * radius_m])
    scene = clradar.Scene.combine([clradar.Scene(m.vertices, m.faces) for m in (ball, box)])
    density = 1e-6 / (wavelength_m / 5) ** 2
    got = clradar.simulate(
        scene, array, waveform, estimator="physical", samples_per_mm2=density
    ).data
    some = np.unique([0, waveform.n_freq // 2, waveform.n_freq - 1])
    lit = lit_points(scene, array, samples_per_mm2=density)
    want = dense(lit, array, clradar.Waveform(waveform.frequencies_hz[some]))
    assert db(got[:, :, some], want) < TOLERANCE_DB

"""Plates against closed forms near and far, and corners by the bouncing tracer."""

from typing import Any

import numpy as np
from shapes import dihedral

import clradar
from clradar import Scene, Waveform
from truths import measured, optics
from truths.measured import Simulator
from truths.page import Row

SIDE_M = 0.05
DISTANCES_M = np.geomspace(0.1, 10, 13)
TILTS_DEG = (0.0, 1.0, 3.0, 5.0, 10.0, 20.0, 30.0)
FAR_M = 10.0

PLATE_BOUND_DB = 0.05
"""What the second moment of a cell leaves: right triangles of legs L = 0.71 mm over which the phase
turns by q L = 1.14 at a tilt of 30 degrees: ((q L)^2/36)^2/2, 0.006 dB."""
CORNER_BOUND_DB = 0.1
"""Rays that spread from 20 m miss the second face on a strip of about R^-1 (3 cm)^2, and float32
at 20 m has steps of 2 um: 0.5 % of the rays, 0.05 dB for each bounce beyond the first."""


RAYS: dict[str, Any] = {
    "estimator": "stochastic", "samples_per_mm2": 20.0, "rays_per_sample": 1,
    "reception_radius_m": 0.2, "normals": "face",
}  # fmt: skip
"""Of the corners: all rays that come back are received, since the Rx sphere is large."""


def sigma_db(u: np.ndarray, distance_m: float) -> float:
    return float(10 * np.log10(optics.cross_section_m2(u, distance_m)))


def over_distance(distances_m: np.ndarray) -> np.ndarray:
    """Rows (distance, found, integral) of a plate on its axis, dBsm as it would be far away."""
    return np.array([(z, *seen(measured.physical, 0.0, z)) for z in distances_m])


def over_tilt(simulate: Simulator, tilts_deg: tuple[float, ...], distance_m: float) -> np.ndarray:
    """Rows (tilt, found, integral), dBsm."""
    return np.array([(tilt, *seen(simulate, tilt, distance_m)) for tilt in tilts_deg])


def seen(simulate: Simulator, tilt_deg: float, distance_m: float) -> tuple[float, float]:
    """What is found of a plate, and the integral over it."""
    f, sides_m = measured.band_hz(1), (SIDE_M, SIDE_M)
    scene = measured.plate(sides_m, distance_m, np.radians(tilt_deg))
    u = simulate(scene, measured.monostatic(np.zeros(3)), f)[0, 0, 0]
    k = measured.wavenumber(f)
    exact = optics.any_rectangle(distance_m, sides_m, np.radians(tilt_deg), k)[0]
    return sigma_db(u, distance_m), sigma_db(exact, distance_m)


def plane(n_freq: int) -> tuple[float, float]:
    """A disc of 12 cm at 0.3 m without the closed form of its rim's wave, relative to the image
    source: largest error of amplitude, dB, and of phase, degrees, over the band."""
    f = measured.band_hz(n_freq)
    k = measured.wavenumber(f)
    z, radius = 0.3, 0.06
    u = measured.physical(measured.disc(radius, z), measured.monostatic(np.zeros(3)), f)[0, 0]
    rim = optics.disc(z, radius, k) - optics.plane(z, k)
    ratio = (u - rim) / optics.image_source(z, k)
    db, phase = 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
    return float(np.abs(db).max()), float(np.abs(phase).max())


def trihedral(size_m: float, z_m: float, square: bool) -> Scene:
    """Three squares or triangles at right angles, their axis towards the radar."""
    edges = size_m * np.eye(3)
    boresight = -np.ones(3) / np.sqrt(3)
    across = np.array([1, -1, 0]) / np.sqrt(2)
    turn = np.stack([across, np.cross(boresight, across), boresight])
    vertices = np.vstack([np.zeros(3), edges])
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1]]
    if square:
        vertices = np.vstack([vertices, edges + np.roll(edges, -1, axis=0)])
        faces = [[0, 1, 4], [0, 4, 2], [0, 2, 5], [0, 5, 3], [0, 3, 6], [0, 6, 1]]
    return Scene(vertices @ turn.T + [0, 0, z_m], np.array(faces), alpha=0.0)


def corners() -> list[Row]:
    """Cross sections of 3 cm corners by the stochastic tracer at alpha = 0, calibrated by a plate.

    Its amplitudes are 1 per ray, and a ray stands for cos(incidence)/density of the wave. So
    |s| cos(incidence) / density is the effective area A, and sigma = 4 pi A^2 / lambda^2. The
    cosine of n faces at right angles is 1 / sqrt(n).
    """
    size, z = 0.03, 20.0
    f = measured.band_hz(1)
    wavelength = measured.C_M_PER_S / f[0]
    array = measured.monostatic(np.zeros(3))

    def received(scene: Scene, bounces: int) -> float:
        capture = clradar.simulate(scene, array, Waveform(f), max_bounces=bounces, **RAYS)
        density = 1e6 * RAYS["samples_per_mm2"]
        area = abs(complex(capture.data[0, 0, 0])) / np.sqrt(bounces) / density
        return float(10 * np.log10(4 * np.pi * (area / wavelength) ** 2))

    truth = 10 * np.log10(4 * np.pi * (size**2 / wavelength) ** 2)
    plate = measured.plate((size, size), z).with_alpha(0.0)
    found = received(plate, 1)
    offset = truth - found
    of_two = optics.dihedral_m2(size, size, wavelength)
    of_square = optics.square_trihedral_m2(size, wavelength)
    of_triangle = optics.triangular_trihedral_m2(size, wavelength)
    cases = {
        "dihedral, two bounces": (Scene(*dihedral(size, z), 0.0), 2, of_two),
        "square trihedral, three bounces": (trihedral(size, z, True), 3, of_square),
        "triangular trihedral, three bounces": (trihedral(size, z, False), 3, of_triangle),
    }
    out = [Row("plate, one bounce (before calibration)", truth, found, 0.01, "dBsm")]
    for name, (scene, bounces, sigma) in cases.items():
        value = received(scene, bounces) + offset
        out.append(Row(name, 10 * np.log10(sigma), value, CORNER_BOUND_DB, "dBsm"))
    return out


def rows(distance: np.ndarray, tilt: np.ndarray, plane_error: tuple[float, float]) -> list[Row]:
    out = [
        Row(f"5 cm on its axis at {z:.2g} m", truth, found, PLATE_BOUND_DB, "dBsm")
        for z, found, truth in distance
    ]
    k = measured.wavenumber(measured.band_hz(1))
    far = 10 * np.log10(optics.tilted_rectangle_m2((SIDE_M, SIDE_M), np.array(0.0), k)[0])
    out.append(Row("the last against 4πA²/λ²", far, distance[-1][1], PLATE_BOUND_DB, "dBsm"))
    for angle, found, truth in tilt:
        row = f"tilted by {angle:g}° at {FAR_M:g} m"
        out.append(Row(row, truth, found, PLATE_BOUND_DB, "dBsm"))
    out.append(Row("plane at 0.3 m, amplitude", 0, plane_error[0], PLATE_BOUND_DB, at_most=True))
    out.append(Row("plane at 0.3 m, phase", 0, plane_error[1], 1.0, "°", at_most=True))
    return out

"""The paths of calibration targets against minimisation and against traced meshes."""

from typing import Any

import numpy as np
import pytest
from recorded_targets import QAR50
from scipy.optimize import minimize

from calibration import CornerReflector, FlatPlate, Sphere, response
from clradar import AntennaArray, Waveform, reference
from clradar.errors import ModelError

# Both are float64; lengths of half a metre have rounding errors of 1e-16 m, and a minimiser stops
# where the length is flat to 1e-16, too.
LENGTH_TOLERANCE_M = 1e-12

FEW = AntennaArray(QAR50.tx_m[::31], QAR50.rx_m[::31])
WIDE = AntennaArray([[-0.4, 0, 0], [0.1, 0.3, 0.02]], [[0.4, 0.1, 0], [0.2, -0.5, 0.1]])


def path_m(point: np.ndarray, tx: np.ndarray, rx: np.ndarray) -> float:
    return float(np.linalg.norm(point - tx) + np.linalg.norm(rx - point))


def shortest(surface: Any, start: np.ndarray, tx: np.ndarray, rx: np.ndarray) -> np.ndarray:
    """The point of a surface (of two parameters) with the shortest path, by simplex search."""
    options = {"xatol": 1e-10, "fatol": 1e-16, "maxiter": 2000}
    found = minimize(
        lambda u: path_m(surface(u), tx, rx), start, method="Nelder-Mead", options=options
    )
    point: np.ndarray = surface(found.x)
    return point


@pytest.mark.parametrize("array", [FEW, WIDE], ids=["imager", "wide"])
@pytest.mark.parametrize("radius_m", [0.005, 0.05, 0.2])
def test_sphere_is_the_shortest_path(array, radius_m):
    centre = np.array([0.02, -0.03, 0.45])
    echo = Sphere(centre, radius_m).echo(array)
    assert echo.seen.all()
    for i, tx in enumerate(array.tx_m):
        for k, rx in enumerate(array.rx_m):

            def surface(u: np.ndarray) -> np.ndarray:
                towards = np.array([u[0], u[1], -1.0])
                return centre + radius_m * towards / np.linalg.norm(towards)

            point = shortest(surface, np.zeros(2), tx, rx)
            assert abs(echo.length_m[i, k] - path_m(point, tx, rx)) < LENGTH_TOLERANCE_M


def test_sphere_between_two_antennas_has_no_reflection():
    array = AntennaArray([[-1.0, 0, 0.3]], [[1.0, 0, 0.3], [-1.0, 0.1, 0.3]])
    echo = Sphere([0, 0, 0.3], 0.05).echo(array)
    assert echo.seen.tolist() == [[False, True]]
    assert not response(Sphere([0, 0, 0.3], 0.05), array, Waveform([1e9]))[0, 0].any()


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (3.0, -7.0)])
def test_plate_is_the_shortest_path(tilt):
    slope = np.tan(np.radians(tilt))
    size = 0.10
    endless = FlatPlate(0.3, *tilt).echo(FEW)
    small = FlatPlate(0.3, *tilt, size_m=(size, 3.0)).echo(FEW)
    on_plate = np.zeros_like(small.seen)
    for i, tx in enumerate(FEW.tx_m):
        for k, rx in enumerate(FEW.rx_m):
            point = shortest(lambda u: np.array([*u, 0.3 + u @ slope]), np.zeros(2), tx, rx)
            assert abs(endless.length_m[i, k] - path_m(point, tx, rx)) < LENGTH_TOLERANCE_M
            along = point[0] * np.hypot(1.0, slope[0])
            # The plate's x axis is in the plane and upright to y: off it, x is not all.
            along += (point[1] * slope[1]) * slope[0] / np.hypot(1.0, slope[0])
            on_plate[i, k] = abs(along) <= size / 2
    assert endless.seen.all()
    assert 0 < on_plate.sum() < on_plate.size
    np.testing.assert_array_equal(small.seen, on_plate)


def test_corner_is_a_point_target():
    waveform = Waveform.sfcw(72e9, 82e9, 5)
    position = np.array([0.01, 0.02, 0.31])
    want = reference.point_targets(QAR50, waveform, position[None], np.ones(1)).data
    got = response(CornerReflector(position), QAR50, waveform)
    assert np.abs(got - want).max() < 1e-6  # complex64


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CornerReflector([0, 0, -0.3]), "in front of the antennas"),
        (lambda: CornerReflector([0, 0]), r"shape \(3,\)"),
        (lambda: CornerReflector([0, np.nan, 0.3]), "finite"),
        (lambda: Sphere([0, 0, 0.3], 0.0), "positive"),
        (lambda: Sphere([0, 0, 0.3], 0.31).echo(QAR50), "no antenna touches"),
        (lambda: FlatPlate(-0.3), "positive"),
        (lambda: FlatPlate(0.3, 80.0), "-60, 60. degrees, got 80 degrees"),
        (lambda: FlatPlate(0.05, 50.0).echo(QAR50), "no antenna touches"),
        (lambda: FlatPlate(0.3, size_m=(0.1, 0.0)), "positive lengths"),
        (lambda: FlatPlate("near"), "a number"),
    ],
)
def test_invalid_targets(make, message):
    with pytest.raises(ModelError, match=message):
        make()

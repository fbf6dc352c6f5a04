"""Pictures of samples through the point spread function."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import convolve2d

from calibration.registration.mesh_rendering import Aperture, Canvas, MeasuredImage
from clradar import arrays

STEP_M = 2e-3


@pytest.fixture(scope="module")
def aperture() -> Aperture:
    return Aperture(arrays.qar50(), 77e9)


@pytest.fixture(scope="module")
def measured() -> MeasuredImage:
    x_m, y_m = np.arange(41) * STEP_M, np.arange(31) * STEP_M
    power = np.random.default_rng(2).random((31, 41))
    return MeasuredImage(x_m, y_m, power, np.full((31, 41), 0.3), (STEP_M, STEP_M))


@pytest.mark.parametrize("lit", [np.s_[:, :], np.s_[12:15, 20:22], np.s_[:2, -1:], np.s_[:0, :0]])
def test_a_picture_is_convolved_wherever_it_is_lit(aperture, measured, lit):
    drawn = np.zeros((2, 3, 31, 41))
    inside = (1, slice(None), *lit)
    drawn[inside] = np.random.default_rng(3).normal(size=drawn.shape)[inside]
    seen = Canvas(measured, aperture).convolved(drawn)
    pattern = aperture.point_spread(0.3, measured.step_m)
    for one, of in zip(seen.reshape(6, 31, 41), drawn.reshape(6, 31, 41), strict=True):
        # 1e-14: some hundred sums in double precision of numbers of about 1.
        assert np.abs(one - convolve2d(of, pattern, "same")).max() < 1e-14 * max(1, np.ptp(of))


def test_a_blurred_picture_is_that_of_a_blurred_image(aperture, measured):
    drawn = np.zeros((31, 41))
    drawn[15, 20] = 1.0
    sharp, soft = (Canvas(measured, aperture, blur_m) for blur_m in (0.0, 2 * STEP_M))
    blurred = gaussian_filter(sharp.convolved(drawn), 2.0, mode="constant", truncate=8.0)
    # The Gaussian in frequency and that of samples in space differ by their aliases, exp(-2 pi^2).
    middle = np.s_[9:22, 12:29]  # as far from the edge as the blur reaches
    assert np.abs(soft.convolved(drawn) - blurred)[middle].max() < 1e-4 * blurred.max()
    assert soft.power.max() == pytest.approx(1.0)

"""Residuals of a measurement beyond those of simulations: their ratio to the noise, and where."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from calibration.registration.alignment import USUAL_RATIO
from calibration.registration.beyond_noise import NOMINAL_NOISE, ResidualImage, beyond_noise

AXIS_M = np.arange(-40, 41) * 2e-3
SHAPE = (len(AXIS_M), len(AXIS_M))
CENTRE_M = np.zeros(3)
NOISE = np.array(list(NOMINAL_NOISE.values()))


def image(rng: np.random.Generator, noise: float = 1.0, **changed: Any) -> ResidualImage:
    """A lit square at 0.3 m whose averaged residuals are noise of the nominal size."""
    level, ranges = (
        noise * std * 4 * np.sqrt(np.pi) * ndimage.gaussian_filter(rng.standard_normal(SHAPE), 2)
        for std in NOISE
    )
    x, y = np.meshgrid(AXIS_M, AXIS_M)
    lit = np.maximum(np.abs(x), np.abs(y)) < 0.05
    range_m = np.sqrt(0.3**2 + x**2 + y**2)
    drawn = np.where(lit, 0.5, 1e-12)
    made = ResidualImage(
        level=level, range=ranges, power=drawn, range_m=np.where(lit, range_m, np.nan),
        drawn=drawn, drawn_m=range_m, x_m=AXIS_M, y_m=AXIS_M,
    )  # fmt: skip
    return replace(made, **changed)


@pytest.mark.parametrize("noise", [0.5, 1.0, 3.0])
def test_noise_alone_has_a_ratio_of_one(noise):
    """Whatever its size, which widens the standard deviation if it is larger than usual."""
    rng = np.random.default_rng(1)
    ratios, widened = [], []
    for _ in range(20):
        simulated = [image(rng, noise) for _ in range(3)]
        found = beyond_noise(image(rng, noise), simulated, np.ones(3), [], CENTRE_M)
        ratios.append(found.ratio)
        widened.append(found.widening)
    # 900 cells share 2500 pixels, so that a ratio scatters by a few hundredths.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    assert np.max(ratios) < USUAL_RATIO
    assert np.mean(widened) == pytest.approx(max(1.0, noise), rel=0.1)


def test_a_place_that_disagrees_is_found_with_its_side():
    """A patch of 2 cm that is measured 5 mm closer and of twice the power."""
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(AXIS_M, AXIS_M)
    patch = np.hypot(x - 0.02, y + 0.01) < 0.01
    clean = image(rng)
    measured = replace(
        clean,
        level=clean.level + 1.0 * patch,
        range=clean.range - 2.5 * patch,
        power=np.where(patch, 2.0, 1.0) * clean.power,
        range_m=clean.range_m - 5e-3 * patch,
    )
    found = beyond_noise(measured, [image(rng) for _ in range(3)], np.ones(3), [], CENTRE_M)
    assert found.ratio > USUAL_RATIO
    assert found.widening > USUAL_RATIO
    worst = found.places[0]
    # To a pixel, and the patch's own extent in depth.
    assert worst.position_m == pytest.approx([0.02, -0.01, 0.295], abs=2e-3)
    assert worst.area_m2 == pytest.approx(np.pi * 0.01**2, rel=0.3)
    assert worst.closer_m == pytest.approx(5e-3, abs=1e-6)
    assert worst.brighter_db == pytest.approx(3.0, abs=0.5)
    assert "measured 5.0 mm closer" in worst.text()
    assert "dB brighter" in worst.text()


def test_an_error_of_alpha_is_no_disagreement():
    """Residuals that change with alpha, and a measurement 0.1 away from the alpha found."""
    rng = np.random.default_rng(3)
    change = ndimage.gaussian_filter(rng.standard_normal(SHAPE), 3)
    change = 45.0 * NOISE[0] * change / change.std()

    def at(alpha: float) -> ResidualImage:
        made = image(rng)
        return replace(made, level=made.level + alpha * change)

    alphas = [0.3, 0.2, 0.25, 0.21, 0.2]
    simulated = [at(alpha) for alpha in alphas]
    weights = np.exp(-0.5 * ((np.array(alphas) - 0.2) / 0.02) ** 2)
    known = beyond_noise(at(0.3), simulated, weights, [], CENTRE_M)
    found = beyond_noise(at(0.3), simulated, weights, alphas, CENTRE_M)
    assert known.ratio > USUAL_RATIO
    assert found.ratio < 1.3
    # Three tenths are another surface.
    assert beyond_noise(at(0.6), simulated, weights, alphas, CENTRE_M).ratio > USUAL_RATIO


def test_too_few_simulations_near_the_pose_say_nothing():
    rng = np.random.default_rng(4)
    weights = np.array([1e-6, 1e-3, 1.0])
    found = beyond_noise(image(rng), [image(rng) for _ in range(3)], weights, [], CENTRE_M)
    assert (found.ratio, found.widening, found.places) == (None, 1.0, ())

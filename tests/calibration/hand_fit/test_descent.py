"""Skinned samples, renderings of hands and the descent on a hand's own rendering."""

from types import SimpleNamespace

import numpy as np
import pytest
from hand_renderings import TIPS, fitter_on, rendered_depth, state_of
from scipy.spatial import KDTree

from calibration.hand_fit.descent import (
    COARSE,
    FINE,
)
from calibration.hand_fit.hand_state import angles_of, pose_with
from calibration.hand_fit.misfit import deviance_map, misfit
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.hand_fit.skinned import SkinnedSamples
from calibration.registration.mesh_fit import POWER_FLOOR, TUKEY_CUTOFF, initial_log_brightness
from calibration.registration.mesh_rendering import MeasuredImage
from clradar.hand import pose_by_name
from clradar.hand.shape import AVERAGE


@pytest.mark.parametrize("kind", ["right", "left", "rig"])
def test_the_frame_of_the_hand_has_the_wrist_at_its_origin(hands, kind):
    model = hands[kind]
    pose = pose_by_name("K")
    mesh = model.mesh(pose, AVERAGE, 4e-3)
    joints_m = model.joints_m(pose, AVERAGE)
    assert joints_m[0] == pytest.approx(0.0, abs=1e-12)
    # 1e-12: the same sums in another order.
    assert np.nanmax(np.abs(mesh.joints_m - joints_m)) < 1e-12
    assert (joints_m[4, 0] > 0) == (kind == "left")  # the thumb


@pytest.mark.parametrize("kind", ["right", "left", "rig"])
def test_samples_follow_the_bones_as_the_mesh_does(hands, kind):
    """A bent finger takes its skin along: 0.5 mm is what blending differs from a mesh made anew,
    where 20 degrees at the knuckle move the tip by 30 mm."""
    model, pose = hands[kind], pose_by_name("flat")
    bent = pose_with(pose, angles_of(pose) + np.radians(20.0) * np.eye(23)[13])
    mesh = model.mesh(pose, AVERAGE, 3e-3)
    normals = mesh.to_trimesh().vertex_normals
    bones = model.bones(pose, AVERAGE)
    skin = model.skin(mesh, pose, AVERAGE, mesh.vertices_m, normals)
    points_m, _ = SkinnedSamples.of(mesh.vertices_m, normals, skin, bones).posed(
        model.bones(bent, AVERAGE)
    )
    anew = model.mesh(bent, AVERAGE, 3e-3).to_trimesh()
    near_tip = np.argsort(np.linalg.norm(points_m - model.joints_m(bent, AVERAGE)[19], axis=1))[:60]
    away_m, _ = KDTree(anew.vertices).query(points_m[near_tip])
    assert np.median(away_m) < 1.6e-3  # half the spacing of the vertices
    assert np.linalg.norm(points_m - mesh.vertices_m, axis=1).max() > 20e-3


def test_the_gradient_of_the_deviance_is_the_score():
    """Of a pixel: c^2 / (1 + c^2) (...) has the derivative -s / (1 + s^2 / c^2) by ln(I + f)."""
    picture = SimpleNamespace()
    picture.power = np.array([[1e-3, 0.02, 0.3, 1.0]])
    picture.measured = MeasuredImage(
        np.arange(4.0), np.zeros(1), picture.power, np.full((1, 4), np.nan), (1.0, 1.0)
    )
    picture.range_std_m = np.ones((1, 4))
    power = np.array([[0.3, 0.1, 0.1, 0.02]])
    step = 1e-5

    def value(scale: float) -> np.ndarray:
        there = ((power + POWER_FLOOR) * np.exp(scale) - POWER_FLOOR, np.ones((1, 4)))
        return deviance_map(picture, there, misfit(picture, there))

    here = misfit(picture, (power, np.ones((1, 4))))
    slope = (value(step) - value(-step)) / (2 * step)
    assert slope == pytest.approx(-here.speckle * here.speckle_weights, rel=1e-6)


def test_a_pixel_that_the_hand_does_not_cover_costs_as_much_as_an_outlier():
    power = np.ones((1, 3))
    canvas = SimpleNamespace(power=power)
    found = SimpleNamespace(
        range_m=np.array([[0.0, 0.0, 1.0]]), range_std_m=np.full((1, 3), 1e-3),
        covered=np.array([[1.0, 0.0, 1.0]]), measured=np.array([[True, True, True]]),
    )  # fmt: skip
    hit, uncovered, outlier = deviance_map(canvas, (power, power), found)[0]
    assert hit == pytest.approx(0.0, abs=1e-12)
    assert uncovered == outlier == pytest.approx(TUKEY_CUTOFF**2 / 12)


@pytest.mark.slow
def test_a_hand_is_found_in_its_own_rendering(hands):
    """Without speckle: told tips to a fraction of a pixel from 8 degrees off in every angle."""
    model = hands["right"]
    truth = state_of(pose_by_name("flat"), model)
    rng = np.random.default_rng(3)
    truth = truth.with_angles(truth.angles_rad + np.radians(8.0) * rng.normal(size=23))
    depth = rendered_depth(model, truth)
    start = state_of(pose_by_name("flat"), model)
    fitter = fitter_on(depth, model)
    prior = Prior.about(start, angle_covariance())
    found = fitter.descend(start, initial_log_brightness(), prior, (COARSE, FINE))
    true_m = model.joints_m(truth.pose, AVERAGE) + truth.transform[:3, 3]
    joints_m = model.joints_m(found.state.pose, AVERAGE)
    joints_m = joints_m @ found.state.transform[:3, :3].T + found.state.transform[:3, 3]
    before_m = model.joints_m(start.pose, AVERAGE) + start.transform[:3, 3]
    off_mm = 1e3 * np.linalg.norm(joints_m - true_m, axis=1)[TIPS]
    before_mm = 1e3 * np.linalg.norm(before_m - true_m, axis=1)[TIPS]
    assert np.median(off_mm) < 1.5
    assert (off_mm < before_mm).all()
    judged = [fitter.judged(found, prior, FINE, seed).deviance for seed in (5, 5, 6)]
    assert judged[0] == judged[1] != judged[2]

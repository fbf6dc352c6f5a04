"""The figure of a fitted hand shows where it is, how certain, and what else was found."""

from typing import Any

import numpy as np
from hand_fits import made_up_fit
from matplotlib.colors import to_hex
from matplotlib.patches import Ellipse

from calibration.hand_fit.figure import OTHERS, hand_fit_figure
from calibration.hand_fit.result import TIPS
from clradar import DepthMap


def points(lines: list[Any]) -> np.ndarray:
    return np.concatenate([line.get_xydata() for line in lines])


def test_joints_tips_and_outline_are_where_the_hand_is():
    axis_m = np.linspace(-0.12, 0.12, 13)
    measured = DepthMap(np.full((13, 13), 0.3), np.ones((13, 13)), axis_m, axis_m, 15.0)
    covariance_m2 = np.tile(np.diag([1e-6, 4e-6, 9e-6]), (25, 1, 1))
    fit = made_up_fit(joint_covariance_m2=covariance_m2)
    amplitude, depth, *_ = hand_fit_figure(measured, fit).axes
    for axes in (amplitude, depth):
        rings = [patch for patch in axes.patches if isinstance(patch, Ellipse)]
        centres_mm = np.array([ring.center for ring in rings])
        assert np.allclose(centres_mm, 1e3 * fit.tips_m[:, :2])
        # Two standard deviations to either side: 2 mm along x, 4 mm along y.
        for ring in rings:
            box = ring.get_path().transformed(ring.get_patch_transform()).get_extents()
            assert np.allclose(box.size, [4.0, 8.0])
        crosses = points([line for line in axes.lines if to_hex(line.get_color()) == OTHERS])
        assert np.allclose(crosses, 1e3 * fit.basins[1].joints_m[list(TIPS), :2])
        # The hand's bounding box, to the pixel of the silhouette.
        outline_mm = np.concatenate(
            [p.vertices for c in axes.collections[1:] for p in c.get_paths()]
        )
        box_mm = 1e3 * fit.scene.vertices_m[:, :2]
        assert np.allclose(outline_mm.min(axis=0), box_mm.min(axis=0), atol=0.5)
        assert np.allclose(outline_mm.max(axis=0), box_mm.max(axis=0), atol=0.5)

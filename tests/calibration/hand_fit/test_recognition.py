"""Refusals and remarks of the fit of a hand."""

from dataclasses import replace

import numpy as np
import pytest
from hand_fits import made_up_fit

from calibration import fit_hand
from calibration.hand_fit.recognition import (
    ELSEWHERE,
    MARGIN_M,
    MIN_OVERLAP,
    check_likeness,
    check_overlap,
    doubts,
)
from calibration.hand_fit.result import DOUBTFUL_LIKENESS, DOUBTFUL_OVERLAP
from clradar import Capture, DepthMap, Volume, VoxelGrid, Waveform, arrays
from clradar.errors import CompareError
from clradar.hand import HandShape


def image_to(end_m: float) -> Volume:
    """A grid around a hand at 0.3 m, whose x ends somewhere."""
    grid = VoxelGrid.from_extent((-0.14, end_m), (-0.14, 0.14), (0.2, 0.4), 20e-3)
    return Volume(np.zeros(grid.shape, np.complex64), grid)


def test_images_without_signal_are_refused_by_one_line_about_the_hand():
    array = arrays.qar50().part(slice(None, None, 24), slice(None, None, 24))
    silent = np.zeros((array.n_tx, array.n_rx, 8), np.complex64)
    for dark in (image_to(0.14), Capture(silent, array, Waveform.sfcw(72e9, 82e9, 8))):
        with pytest.raises(CompareError, match=r"^could not fit the hand, because [^\n]*$"):
            fit_hand(dark, "F", device="pocl")


def test_what_is_no_hand_is_refused():
    for likeness in (0.1, float("nan")):
        with pytest.raises(CompareError, match=r"correlate by .* 0.60 is the least"):
            check_likeness(likeness)
    check_likeness(0.7)
    with pytest.raises(CompareError, match=r"from 'F', it overlaps .* by 0.52, .*pose='all'"):
        check_overlap(0.52, "F")
    check_overlap(MIN_OVERLAP, "F")


def test_a_fit_that_overlaps_little_is_doubted_and_a_good_one_is_not():
    sure = {"joint_covariance_m2": np.tile(1e-6 * np.eye(3), (25, 1, 1))}
    right = (made_up_fit(**sure), made_up_fit(overlap=None, likeness=0.93, **sure))
    for fit in right:
        assert doubts(fit, image_to(0.14), ELSEWHERE) == ()
        (remark,) = doubts(fit, image_to(0.14), 9.0)
        assert "in front of or behind" in remark
        assert "3.0 times as large" in remark
        assert fit.told_tips.all()
        assert not fit.doubtful
    wrong = (
        made_up_fit("F", "L", overlap=DOUBTFUL_OVERLAP - 0.01, **sure),
        made_up_fit("F", "L", overlap=None, likeness=DOUBTFUL_LIKENESS - 0.01, **sure),
    )
    for fit in wrong:
        assert not fit.told_tips.any()
        assert not fit.told_angles.any()
        assert any("as of a hand of other proportions" in each for each in fit.remarks())


def test_the_digits_that_are_cut_are_named():
    fit = made_up_fit("B")
    order = np.argsort(-fit.tips_m[:, 0])  # the little finger is farthest along x
    assert order[0] == 4
    end_m = 0.5 * (fit.tips_m[4, 0] + fit.tips_m[3, 0])
    assert end_m - MARGIN_M > fit.tips_m[3, 0]
    axis_m = np.linspace(-0.14, 0.14, 15)
    x_m = np.linspace(-0.14, end_m, 15)
    depth = DepthMap(np.full((15, 15), 0.3), np.ones((15, 15)), x_m, axis_m, 20.0)
    (remark,) = doubts(fit, depth)
    assert "are the tips of: pinky (" in remark
    joints_m = np.array(fit.joints_m)
    joints_m[4] = np.nan  # a rig without a tip is not cut
    assert doubts(made_up_fit("B", joints_m=joints_m), image_to(0.14)) == ()
    near = VoxelGrid.from_extent((-0.14, 0.14), (-0.14, 0.14), (0.32, 0.4), 20e-3)
    (remark,) = doubts(fit, Volume(np.zeros(near.shape, np.complex64), near))
    assert "thumb, index, middle, ring, pinky (" in remark


def test_an_unusual_shape_is_remarked_where_it_was_fitted():
    fit = made_up_fit(shape=HandShape(girth=1.2))  # log 1.2 / 0.045 = 4.05
    assert doubts(fit, image_to(0.14)) == ()
    fitted = replace(fit, parameter_names=(*fit.parameter_names, "shape girth"))
    (remark,) = doubts(fitted, image_to(0.14))
    assert remark == "its shape is unusual: girth 4.1 standard deviations above the average adult's"

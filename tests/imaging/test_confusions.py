"""Messages about grating lobes and range aliases: of simulations and of images."""

import warnings
from functools import partial

import numpy as np
import pytest
import trimesh
from comparisons import warnings_of

import clradar
from clradar.arrays.lobes import ghosts, range_aliases
from clradar.errors import ClradarWarning
from clradar.tracing.ambiguous import warn_of_ambiguity

LINES = np.linspace(-1, 1, 12), np.linspace(-1, 1, 16)
CROSS = clradar.AntennaArray(
    LINES[0][:, None] * [0.0275, 0, 0], LINES[1][:, None] * [0, 0.0375, 0], "cross"
)
"""5 mm apart: a wavelength at 60 GHz."""

BAND = clradar.Waveform.sfcw(60e9, 64e9, 64)
"""Unambiguous to 2.36 m."""


imaged = partial(warnings_of, clradar.backproject)


def echo(at_m: list[float], array: clradar.AntennaArray = CROSS) -> clradar.Capture:
    return clradar.room_capture(array, BAND, [], points_m=[at_m])


def around(at_m: list[float], half_m: float = 0.15) -> clradar.VoxelGrid:
    return clradar.VoxelGrid.from_extent(
        *((c - half_m, c + half_m) for c in at_m), spacing_m=half_m / 10
    )


def test_an_alias_is_as_bright_as_the_echo_far_away_and_not_near():
    for at_m, low, high in (([0, 0, 20.0], 0.99, 1.0), ([0, 0, 0.3], 0.2, 0.9)):
        ((place_m, level),) = range_aliases(CROSS, BAND, np.array(at_m), [1])
        assert low < level <= high
        assert abs(place_m[2] - at_m[2] - BAND.unambiguous_range_m) < 0.02
    assert range_aliases(CROSS, BAND, np.array([0, 0, 1.0]), [-1]) == []  # behind


def test_a_lobe_in_the_grid_and_the_lobe_of_an_echo_beside_it():
    wide = clradar.VoxelGrid.from_extent((-1.1, 1.1), (-0.1, 0.1), (0.2, 1.1), 0.02)
    (text,) = imaged(echo([0, 0, 1.0]), wide)
    assert text.startswith("the array has a grating lobe in the grid: the echo at x 0.00")
    assert "-0.9 dB" in text
    assert imaged(echo([0, 0, 1.0]), around([0, 0, 1.0])) == []
    ((lobe, *_),) = ghosts(CROSS, BAND, np.array([0, 0, 1.0]), lambda p: p[:, 0] > 0.5)
    (text,) = imaged(echo([0, 0, 1.0]), around(list(lobe.position_m), 0.1))
    assert "is the grating lobe of an echo at x" in text


def test_a_far_target_in_a_near_grid():
    """At 5 m, two unambiguous ranges beyond 0.28 m."""
    (text,) = imaged(echo([0, 0, 5.0]), around([0, 0, 0.3], 0.1))
    assert "is the alias of an echo at" in text
    assert imaged(echo([0, 0, 2.0]), around([0, 0, 2.0])) == []


def plate(width_m: float, z_m: float) -> clradar.Scene:
    mesh = trimesh.creation.box((width_m, 0.05, 0.02)).apply_translation([0, 0, z_m])
    return clradar.Scene.from_mesh(mesh, alpha=0.5)


def test_simulations_say_what_their_scene_meets():
    settings = {"estimator": "expected", "samples_per_mm2": 2e-3}
    with pytest.warns(ClradarWarning, match=r"range of 5\.01 m, .*2\.36 m.* 0\.2\d+ m"):
        clradar.simulate(plate(0.05, 5.0), CROSS, BAND, **settings)
    with pytest.warns(ClradarWarning, match="as wide as the array's grating lobes.* dB"):
        clradar.simulate(plate(2.0, 0.8), CROSS, BAND, **settings)


@pytest.mark.parametrize(("width_m", "warned"), [(0.048, False), (0.052, True)])
def test_scenes_narrower_than_a_twentieth_of_their_range_have_no_doubles(width_m, warned):
    """Receivers 16 cm apart at 61 GHz: lobes 0.03 of a sine apart."""
    array = clradar.AntennaArray([[0, 0, 0]], np.arange(-2, 3)[:, None] * [0.16, 0, 0])
    scene = clradar.Scene(
        np.array([[-1, 0, 0], [1, 0, 0], [0, 0.01, 0]]) * width_m / 2 + [0, 0, 1], [[0, 1, 2]]
    )
    assert len(warnings_of(warn_of_ambiguity, scene, array, BAND)) == warned


def test_the_imager_and_its_hand_raise_no_message():
    radar, band = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 128)
    assert ghosts(radar, band, np.array([0, 0, 0.3]), np.all) == [[]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clradar.simulate(plate(0.15, 0.3), radar, band, estimator="expected", samples_per_mm2=2e-3)


def test_images_of_several_captures_are_checked_as_one():
    """Three clusters 60 mm apart: lobes at sin = lambda / 120 mm, which no cluster has alone."""
    own = np.arange(-1, 2)[:, None] * [1.0, 0, 0]
    at_m = np.arange(-1, 2)[:, None] * [0.06, 0, 0]
    wall = [clradar.AntennaArray(6e-3 * own + at, 2e-3 * own + at) for at in at_m]
    band = clradar.Waveform.sfcw(72e9, 82e9, 128)

    def said(point_m: list[float], x_m: tuple[float, float]) -> list[str]:
        captures = (clradar.room_capture(one, band, [], points_m=[point_m]) for one in wall)
        grid = clradar.VoxelGrid.from_extent(x_m, (0, 0), (0.96, 1.04), 4e-3)
        return warnings_of(clradar.backproject, captures, grid)

    (text,) = said([0, 0, 1.0], (-0.08, 0.08))
    # To either side, whichever.
    assert "the echo at x 0.000, y 0.000, z 1.000 m appears at x" in text
    assert "32, y 0, z 999 mm" in text
    (text,) = said([0, 0, 1.0], (0.02, 0.048))
    assert "is the grating lobe of an echo at x" in text

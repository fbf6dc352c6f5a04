"""Projections and depth maps against closed forms; records in numpy, xarray and notebooks."""

import json
import re
import sys
from html import unescape

import numpy as np
import pytest

import clradar
from clradar import Volume, VoxelGrid
from clradar.errors import MissingPackage
from clradar.model.material import METAL
from clradar.plot import notebook

# Amplitudes are float32: each errs by 6e-8 of about 1. The parabola's vertex divides differences of
# them by a curvature of 0.2 here, so by some 1e-6 of a voxel.
VERTEX_ERROR = 2e-6
# Depths are origin + spacing * index below 1 m in float64.
ROUNDING_M = 1e-15

SPACING_M = 2e-3
FIRST_M = 0.26


def image_of(amplitude: np.ndarray) -> Volume:
    """A volume whose amplitude[z, y, x] is given, with random phases."""
    n_z, n_y, n_x = amplitude.shape
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, amplitude.shape)
    grid = VoxelGrid(
        np.array([-0.01, -0.02, FIRST_M]), np.array([1e-3, 3e-3, SPACING_M]), (n_x, n_y, n_z)
    )
    return Volume(amplitude * np.exp(1j * phase), grid)


def column(*amplitude: float) -> Volume:
    """A volume of one column along z, its phases zero."""
    data = np.array(amplitude, np.complex64)[:, None, None]
    return Volume(
        data, VoxelGrid(np.array([0, 0, FIRST_M]), np.full(3, SPACING_M), (1, 1, len(data)))
    )


def depth_in_voxels(image: Volume) -> np.ndarray:
    return (image.depth_map().depth_m - FIRST_M) / SPACING_M


def test_max_projection_is_the_largest_amplitude_along_z():
    amplitude = np.random.default_rng(1).uniform(0, 1, (5, 4, 3))
    image = image_of(amplitude).max_projection()
    assert image.shape == (4, 3)
    assert image.dtype == np.float32
    # |exp(j phase)| in complex64: two products, a sum and a root, 6e-8 each.
    np.testing.assert_allclose(image, amplitude.max(axis=0), rtol=3e-7)


@pytest.mark.parametrize(
    ("samples", "depth"),
    [
        ((0.0, 1.0, 1.0), 1.5),  # two equal: half way between them
        ((0.2, 1.0, 0.8), 1.3),  # 0.5 (0.2 - 0.8) / (0.2 - 2 + 0.8)
        ((0.7, 0.7, 0.7), 0.0),  # the first of equal ones is an end
        ((0.1, 0.7, 0.7, 0.7, 0.1), 1.5),
        ((1.0, 0.9, 0.1), 0.0),  # no refinement at the ends
        ((0.1, 0.9, 1.0), 2.0),
        ((1.0,), 0.0),
        ((0.2, 1.0, 0.1, 0.9, 1.0, 0.9), 0.5 * (0.2 - 0.1) / (0.2 - 2 + 0.1) + 1),
    ],
)
def test_the_vertex_by_hand(samples, depth):
    assert depth_in_voxels(column(*samples))[0, 0] == pytest.approx(depth, abs=VERTEX_ERROR)


@pytest.mark.parametrize("dynamic_range_db", [3.0, 40.0])
def test_the_cut_lies_at_the_dynamic_range(dynamic_range_db):
    # 0.01 dB to either side of the cut; float32 amplitudes err by 1e-6 dB.
    levels_db = -dynamic_range_db + np.array([0.01, -0.01])
    amplitude = np.zeros((3, 1, 4))
    amplitude[1, 0] = [1.0, *10 ** (levels_db / 20), 0.0]
    depth_map = image_of(amplitude).depth_map(dynamic_range_db)
    assert depth_map.mask.tolist() == [[True, True, False, False]]
    assert depth_map.dynamic_range_db == dynamic_range_db
    np.testing.assert_array_equal(np.isnan(depth_map.depth_m), ~depth_map.mask)
    np.testing.assert_allclose(depth_map.amplitude, amplitude[1], rtol=3e-7)


def test_nothing_anywhere_is_nan_everywhere():
    depth_map = image_of(np.zeros((4, 3, 2))).depth_map()
    assert np.isnan(depth_map.depth_m).all()
    assert not depth_map.amplitude.any()
    assert depth_map.points_m().shape == (0, 3)
    assert not image_of(np.zeros((4, 3, 2))).max_projection().any()


def test_axes_and_points():
    amplitude = np.zeros((3, 2, 3))
    amplitude[1, 0, 2] = 1.0
    amplitude[2, 1, 0] = 0.9
    depth_map = image_of(amplitude).depth_map()
    x_m, y_m = -0.01 + 1e-3 * np.arange(3), -0.02 + 3e-3 * np.arange(2)
    np.testing.assert_allclose(depth_map.x_m, x_m, rtol=0, atol=ROUNDING_M)
    np.testing.assert_allclose(depth_map.y_m, y_m, rtol=0, atol=ROUNDING_M)
    want = [[-0.008, -0.02, FIRST_M + SPACING_M], [-0.01, -0.017, FIRST_M + 2 * SPACING_M]]
    np.testing.assert_allclose(depth_map.points_m(), want, rtol=0, atol=ROUNDING_M)


NASTY = "<script>alert('x')</script> & \"<b>\""


def volume(n_x: int = 5, n_y: int = 3) -> clradar.Volume:
    """The strongest voxel is the first along x and the last along y; one is 15 dB below it."""
    grid = clradar.VoxelGrid([-0.1, 0.2, 0.3], [1e-3, 2e-3, 5e-3], (n_x, n_y, 4))
    data = np.zeros(grid.shape, np.complex64)
    data[2, -1, 0] = 10j
    data[1, 0, 1] = 10 * 10 ** (-15 / 20)
    return clradar.Volume(data, grid, {"note": NASTY})


def capture() -> clradar.Capture:
    array = clradar.AntennaArray(np.zeros((2, 3)), np.ones((3, 3)), NASTY)
    data = np.arange(24).reshape(2, 3, 4) + 1j
    return clradar.Capture(data, array, clradar.Waveform.sfcw(72e9, 82e9, 4), {"seed": 1})


class Page:
    """The tags of a page, its text, and how many pictures it has."""

    def __init__(self, text: str) -> None:
        assert not re.search(r"<[^>]* on\w+=", text)
        self.tags = set(re.findall(r"<(\w+)", text))
        self.pictures = text.count("data:image/png;base64,")
        self.text = unescape(re.sub(r"<[^>]*>", "", text))


SCENE = clradar.Scene(np.eye(3), [[0, 1, 2]], part_names=(NASTY,))
SHOWN = {
    volume(): ("strongest voxel10", NASTY, 1),
    volume().depth_map(): ("2 of 15, down to -15 dB", "-100 to -96 mm, 5 values", 1),
    capture(): ("strongest sample23", NASTY, 1),
    capture().array: ("2 Tx, 3 Rx within 1000 mm x 1000 mm", NASTY, 1),
    capture().waveform: ("72 to 82 GHz, 4", "range resolution15 mm", 0),
    volume().grid: ("300 to 315 mm, 4 values", "200 to 204 mm, 3 values", 0),
    SCENE: ("faces1", NASTY, 0),
}


@pytest.mark.parametrize("record", SHOWN, ids=lambda record: type(record).__name__)
def test_notebooks_show_a_figure_and_escaped_facts(record, monkeypatch):
    if not isinstance(record, clradar.DepthMap):  # one that is drawn is enough
        monkeypatch.setattr(notebook, "figure_bytes", lambda *_, **__: b"")
    page = Page(record._repr_html_())
    assert page.tags <= {"div", "strong", "table", "tr", "th", "td", "img"}
    *facts, pictures = SHOWN[record]
    assert [fact for fact in facts if fact not in page.text] == []
    assert page.pictures == pictures
    assert page.text.startswith(type(record).__name__)


def test_metrics_have_a_table_and_what_cannot_be_drawn_has_facts():
    image = clradar.DepthMap(np.full((11, 11), 0.3), np.eye(11), np.arange(11.0), np.arange(11.0))
    text = Page(clradar.compare(image, image)._repr_html_()).text
    assert "overlap1.000" in text
    assert "depth RMSE (mm)0.00" in text
    dark = clradar.Volume(np.zeros(volume().grid.shape), volume().grid)
    page = Page(dark._repr_html_())
    assert page.pictures == 0
    assert "strongest voxel0" in page.text
    assert METAL._repr_html_() is None  # a notebook then shows its text


def test_numpy_takes_records_for_their_arrays():
    image = volume()
    assert np.asarray(image) is image.data or np.shares_memory(np.asarray(image), image.data)
    assert np.abs(capture()).shape == (2, 3, 4)
    np.testing.assert_array_equal(image.depth_map(), image.depth_map().depth_m)
    assert not np.shares_memory(np.array(image), image.data)
    assert np.asarray(image, np.complex128).dtype == np.complex128


def test_xarray_has_axes_units_and_provenance():
    image = volume()
    voxels = image.to_xarray()
    assert voxels.dims == ("z_m", "y_m", "x_m")
    assert voxels.sel(x_m=-0.1, method="nearest").isel(y_m=-1, z_m=2).item() == 10j
    assert {voxels[name].attrs["units"] for name in voxels.dims} == {"m"}
    assert json.loads(voxels.attrs["provenance"]) == {"note": NASTY}
    samples = capture().to_xarray()
    assert samples.capture.sel(tx=1, rx=2, frequency_hz=82e9).item() == 23 + 1j
    assert samples.frequency_hz.attrs["units"] == "Hz"
    assert samples.rx_m.sel(coordinate="z").values.tolist() == [1, 1, 1]
    seen = image.depth_map().to_xarray()
    assert seen.depth_m.attrs["units"] == "m"
    assert float(seen.depth_m.isel(y_m=-1, x_m=0)) == 0.31
    assert np.isnan(seen.depth_m).sum() == 13


def test_xarray_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    for record in (volume(), volume().depth_map(), capture()):
        with pytest.raises(MissingPackage, match=r"to_xarray: .*pip install xarray"):
            record.to_xarray()

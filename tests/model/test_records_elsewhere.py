"""Records in numpy, xarray and notebooks."""

from __future__ import annotations

import base64
import io
import json
import sys
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from PIL import Image

import clradar
from clradar.errors import MissingPackage

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


class Page(HTMLParser):
    """The tags of a page, its pictures, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.pictures: list[np.ndarray] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            assert not name.startswith("on")
            if name == "src":
                kind, content = value.split(",")
                assert kind == "data:image/png;base64"
                with Image.open(io.BytesIO(base64.b64decode(content))) as image:
                    self.pictures.append(np.array(image))

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.parametrize("record", [volume(), volume().depth_map(), capture()])
def test_notebooks_show_a_picture_and_escaped_facts(record: Any) -> None:
    page = Page(record._repr_html_())
    assert set(page.tags) <= {"div", "strong", "table", "tr", "th", "td", "img", "small"}
    assert len(page.pictures) == 1
    assert type(record).__name__ in page.text
    if not isinstance(record, clradar.DepthMap):
        assert NASTY in page.text
    assert len(record._repr_html_()) < 5000


def test_pictures_show_the_scene_as_the_radar_sees_it() -> None:
    # x to the left and y up: the strongest voxel, first along x and last along y, is top right.
    (picture,) = Page(volume()._repr_html_()).pictures
    assert picture.shape == (3, 5)
    assert picture[0, 4] == 255
    assert picture[2, 3] == round(255 / 2)  # 15 of 30 dB below
    assert np.count_nonzero(picture) == 2
    (picture,) = Page(volume().depth_map()._repr_html_()).pictures
    assert picture[2, 3] == 255  # the nearer one
    assert picture[0, 4] == 64
    assert np.count_nonzero(picture) == 2
    (picture,) = Page(capture()._repr_html_()).pictures
    assert picture.shape == (2, 3)
    assert picture[1, 2] == 255  # the last Tx and Rx


def test_pictures_are_small_and_keep_single_bright_pixels() -> None:
    (picture,) = Page(volume(1001, 333)._repr_html_()).pictures
    assert max(picture.shape) <= 160
    assert picture.max() == 255
    assert len(volume(1001, 333)._repr_html_()) < 10_000


def test_dark_records_have_a_picture_too() -> None:
    grid = volume().grid
    dark = clradar.Volume(np.zeros(grid.shape), grid)
    for record in (dark, dark.depth_map()):
        (picture,) = Page(record._repr_html_()).pictures
        assert not picture.any()


def test_numpy_takes_records_for_their_arrays() -> None:
    image = volume()
    assert np.asarray(image) is image.data or np.shares_memory(np.asarray(image), image.data)
    assert np.abs(capture()).shape == (2, 3, 4)
    np.testing.assert_array_equal(image.depth_map(), image.depth_map().depth_m)
    copied = np.array(image)
    copied[0, 0, 0] = 1  # the record stays as it is
    assert image.data[0, 0, 0] == 0
    assert np.asarray(image, np.complex128).dtype == np.complex128


def test_xarray_has_axes_units_and_provenance() -> None:
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


def test_xarray_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    for record in (volume(), volume().depth_map(), capture()):
        with pytest.raises(MissingPackage, match=r"to_xarray: .*clradar\["):
            record.to_xarray()

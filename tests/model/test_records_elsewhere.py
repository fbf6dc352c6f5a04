"""Records in numpy, xarray and notebooks."""

import json
import re
import sys
from html import unescape

import numpy as np
import pytest

import clradar
from clradar.errors import MissingPackage
from clradar.model.material import METAL
from clradar.plot import notebook

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
    SCENE: ("faces1", NASTY, 1),
}


@pytest.mark.parametrize("record", SHOWN, ids=lambda record: type(record).__name__)
def test_notebooks_show_a_figure_and_escaped_facts(record, monkeypatch):
    if not isinstance(record, clradar.DepthMap):  # one that is drawn is enough
        monkeypatch.setattr(notebook, "png_bytes", lambda *_, **__: b"")
    page = Page(record._repr_html_())
    assert page.tags <= {"div", "strong", "table", "tr", "th", "td", "img"}
    *facts, pictures = SHOWN[record]
    assert [fact for fact in facts if fact not in page.text] == []
    assert page.pictures == pictures
    assert page.text.startswith(type(record).__name__)


def test_metrics_have_a_table_and_what_cannot_be_drawn_has_facts(monkeypatch):
    image = clradar.DepthMap(np.full((11, 11), 0.3), np.eye(11), np.arange(11.0), np.arange(11.0))
    text = Page(clradar.compare(image, image)._repr_html_()).text
    assert "overlap1.000" in text
    assert "depth RMSE (mm)0.00" in text
    dark = clradar.Volume(np.zeros(volume().grid.shape), volume().grid)
    page = Page(dark._repr_html_())
    assert page.pictures == 0
    assert "strongest voxel0" in page.text
    monkeypatch.setattr(notebook, "MOST_FACES", 0)
    page = Page(SCENE._repr_html_())
    assert page.pictures == 0
    assert "faces1" in page.text
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

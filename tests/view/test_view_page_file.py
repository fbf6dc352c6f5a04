"""A view as one file: its time line in a browser, nothing from elsewhere, and what is refused."""

import base64
import io

import chromium
import numpy as np
import pytest
from PIL import Image

import clradar
from clradar.errors import ClradarError, OutputError
from clradar.view.page_file import write_page
from clradar.view.session import View
from clradar.view.sources import open_source
from clradar.view.wish import Wish
from measurement_io import save_volume

pytest.importorskip("viser")

SIDE = slice(150, 600), slice(20, 780)
"""Rows and columns of the scene between the browser's notices and viser's controls."""


def volumes(folder):
    """Three volumes with a bright voxel from left to right, each on a grid of its own.

    The second is damaged.
    """
    folder.mkdir()
    for i, column in enumerate((9, 5, 1)):
        origin_m = np.array([-0.1, -0.1, 0.26 + 0.02 * i])
        grid = clradar.VoxelGrid(origin_m, np.full(3, 0.02), (11, 11, 5))
        data = np.zeros(grid.shape, np.complex64)
        data[2, 5, column] = 1.0
        save_volume(folder / f"{i}.h5", clradar.Volume(data, grid))
    with open(folder / "1.h5", "r+b") as file:
        file.truncate(1000)
    return folder


@pytest.mark.skipif(chromium.installed() is None, reason="no Chromium here to open the page")
def test_the_page_plays_without_a_server(tmp_path):
    source, page_file = open_source(volumes(tmp_path / "volumes")), tmp_path / "view.html"
    said: list[str] = []
    assert write_page(View(source=source, wish=Wish()), page_file, warn=said.append) == 2
    assert len(said) == 1
    assert "1.h5" in said[0]
    with chromium.chromium(tmp_path / "profile", webgl=True) as page:
        page.resize(800, 600)
        page.open(page_file)
        seen: set[str] = set()
        while len(seen) < 2:  # it plays by itself, around the end
            page.settle()
            shot = base64.b64decode(page.call("Page.captureScreenshot")["data"])
            image = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), np.int16)[SIDE]
            columns = np.nonzero(np.ptp(image, axis=2) > 60)[1]
            if len(columns) > 20:
                seen.add("left" if columns.mean() < 380 else "right")
        urls = page.requests()
    assert [u for u in urls if not u.startswith((page_file.as_uri(), "data:", "blob:"))] == []


def test_pages_that_are_not_written(tmp_path):
    folder, page_file = volumes(tmp_path / "volumes"), tmp_path / "view.html"
    (folder / "0.h5").unlink()
    (folder / "2.h5").unlink()
    source = open_source(folder)
    with pytest.raises(ClradarError, match="expected a frame that can be shown"):
        write_page(View(source=source, wish=Wish()), page_file, warn=lambda _: None)
    assert not page_file.exists()
    page_file.write_text("as it was")
    with pytest.raises(OutputError, match="exists already"):
        write_page(View(source=source, wish=Wish()), page_file)
    assert page_file.read_text() == "as it was"

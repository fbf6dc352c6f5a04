"""The live view, and a view as one file, in a browser: pixels, keys, nothing from elsewhere."""

import base64
import io
import json
import threading
import time

import chromium
import numpy as np
import pytest
from fronts import frames, volume
from PIL import Image

import clradar
import clradar.view
from clradar.errors import ClradarError, OutputError
from clradar.view import server
from clradar.view.beside import recorded
from clradar.view.drawn import Drawn
from clradar.view.panel import Panel
from clradar.view.scene import SceneView
from clradar.view.session import Shown, View
from clradar.view.sources import open_source
from clradar.view.wish import LAYOUTS, Wish
from measurement_io import save_volume

pytest.importorskip("viser")

needs_a_browser = pytest.mark.skipif(
    chromium.installed() is None,
    reason="no Chromium here: install Debian's chromium package to try the view in a browser",
)

PLACE = (
    "[...document.querySelectorAll('input')].filter(one => one.inputMode === 'decimal')"
    ".slice(-3).map(one => Number(one.value))"
)
"""The three numbers of the place, millimetres."""


SIZE = (800, 600)
SCENE = slice(200, 560), slice(20, 440)
"""Rows and columns beside the panel and below the browser's own notice about software WebGL."""


def shot(page):
    """What a page shows once the last messages are drawn, (rows, columns, 3)."""
    page.settle()
    content = base64.b64decode(page.call("Page.captureScreenshot")["data"])
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), np.int16)


class Tab:
    """A tab that looks at a view."""

    def __init__(self, page, address):
        self.page, self.address = page, address
        page.resize(*SIZE)

    def load(self, words):
        self.page.open(self.address)
        self.says(words)

    def says(self, words):
        """Wait until the page contains these words."""
        self.until(f"document.body.textContent.includes({json.dumps(words)})")

    def until(self, condition):
        """Wait until an expression is true; a value that a script sets is no event of the page."""
        end_s = time.monotonic() + chromium.DEADLINE_S
        while not self.page.js(f"Boolean({condition})"):
            assert time.monotonic() < end_s, f"waited in vain until {condition}"
            time.sleep(0.05)

    def click(self, x, y):
        for kind in ("mousePressed", "mouseReleased"):
            self.page.mouse(kind, x, y, button="left", clickCount=1)

    def lit(self, wanted):
        """Wait until the columns of pixels in the measured and the simulated colours are as wanted.

        Returns those of the measured ones.
        """
        while True:
            image = shot(self.page)[SCENE]
            coloured = np.ptp(image, axis=2) > 60
            cyan = image.argmin(axis=2) == 0
            measured = np.nonzero(coloured & ~cyan)[1] + SCENE[1].start
            simulated = np.nonzero(coloured & cyan)[1] + SCENE[1].start
            if wanted(measured, simulated):
                return measured


@needs_a_browser
def test_frames_follow_the_keys_and_nothing_comes_from_elsewhere(tmp_path):
    """Without WebGL, whose software drawing takes most of the time: not the 3-D scene."""
    view = View(source=frames(volume(), volume()), wish=Wish())
    with server.serving(view, 0) as (port, _), chromium.chromium(tmp_path) as page:
        address = f"http://127.0.0.1:{port}"
        tab = Tab(page, address)
        tab.load("rec 0: volume of")
        page.key("n", "KeyN")
        tab.says("rec 1: volume of")
        asked = page.requests()
        assert asked
        assert [url for url in asked if not url.startswith((address, "data:", "blob:"))] == []


def spot(x_m):
    """A volume that is bright at one place."""
    grid = clradar.VoxelGrid.from_extent((-0.08, 0.08), (-0.08, 0.08), (0.28, 0.32), 4e-3)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    power = ((x - x_m) ** 2 + y**2 + (z - 0.3) ** 2) / 8e-3**2
    return clradar.Volume(np.exp(-power).astype(np.complex64), grid)


@pytest.mark.slow
@needs_a_browser
def test_frames_keys_reload_and_two_browsers(tmp_path):
    source, along = frames(spot(0.03), spot(0.0)), frames(spot(0.0), name="simulated")
    view = View(source=source, wish=Wish(), beside=recorded(source, [along]))
    with server.serving(view, 0) as (port, _), chromium.chromium(tmp_path, webgl=True) as page:
        address = f"http://127.0.0.1:{port}"
        tab = Tab(page, address)
        tab.load("simulated")
        tab.says("dB correlation")
        for _ in range(2):  # pictures and points, pictures alone, points alone
            page.key("l", "KeyL")
        # The larger x is to the left.
        left = tab.lit(lambda m, s: len(m) > 50 and len(s) > 50 and m.mean() < s.mean() - 25)
        tab.click((SIZE[0] - 350) / 2, SIZE[1] / 2)  # the simulated point, beside the panel
        tab.until(f"Math.abs({PLACE}[0]) < 3")
        page.key("b", "KeyB")
        tab.lit(lambda m, s: len(m) > 50 and len(s) == 0)
        page.key("b", "KeyB")
        tab.lit(lambda m, s: len(m) == 0 and len(s) > 50)
        page.key("b", "KeyB")
        tab.lit(lambda m, s: len(m) > 50 and len(s) > 50)
        page.key("b", "KeyB")
        page.js("document.activeElement.blur()")
        page.key("n", "KeyN")
        tab.says("rec 1: volume of")
        # It has moved to the right: the key did not turn the camera, which shows it in the middle.
        tab.lit(lambda m, s: len(m) > 50 and m.mean() > left.mean() + 25)
        page.key("v", "KeyV")
        tab.says("voxels drawn")

        # A browser that comes later, or again, sees the same.
        tab.load("voxels drawn")
        tab.lit(lambda m, s: len(m) > 50 and m.mean() > left.mean() + 25)
        other = Tab(page.another(), address)
        other.load("rec 1: volume of")
        other.page.key("p", "KeyP")
        other.says("rec 0: volume of")
        tab.says("rec 0: volume of")
        other.page.key(" ", "Space")  # plays
        for frame in (1, 0, 1):
            tab.says(f"rec {frame}: volume of")


def test_an_iterable_is_shown_until_its_error(monkeypatch):
    """Ten lines of a lab: a generator that ends with an error once a frame was seen."""
    seen, draw = threading.Event(), Panel.show

    def drawn(self, shown):
        draw(self, shown)
        seen.set()

    def measured():
        while not seen.is_set():
            yield volume()
        raise RuntimeError("the radar was switched off")

    monkeypatch.setattr(Panel, "show", drawn)
    with pytest.raises(RuntimeError, match="switched off"):
        clradar.view.show(measured(), title="lab", port=0)


def test_a_mesh_that_is_hidden_stays_so_from_layout_to_layout():
    mesh = clradar.Scene([[0, 0, 0.3], [0.01, 0, 0.3], [0, 0.01, 0.3]], [[0, 1, 2]])
    view = View(source=frames(volume()), wish=Wish(), mesh=mesh)
    with server.running("view", 0) as (viser, _):
        scene = SceneView(viser, view)
        scene.mesh.visible = False
        for layout in LAYOUTS:
            scene.show(Shown(Wish(layout=layout), volume(), Drawn.of(volume(), 15.0)))
        assert not scene.mesh.visible


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


@needs_a_browser
def test_the_page_plays_without_a_server(tmp_path):
    source, page_file = open_source(volumes(tmp_path / "volumes")), tmp_path / "view.html"
    said: list[str] = []
    assert server.write_page(View(source=source, wish=Wish()), page_file, warn=said.append) == 2
    assert len(said) == 1
    assert "1.h5" in said[0]
    with chromium.chromium(tmp_path / "profile", webgl=True) as page:
        page.resize(*SIZE)
        page.open(page_file)
        seen: set[str] = set()
        while len(seen) < 2:  # it plays by itself, around the end
            columns = np.nonzero(np.ptp(shot(page)[SIDE], axis=2) > 60)[1]
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
        server.write_page(View(source=source, wish=Wish()), page_file, warn=lambda _: None)
    assert not page_file.exists()
    page_file.write_text("as it was")
    with pytest.raises(OutputError, match="exists already"):
        server.write_page(View(source=source, wish=Wish()), page_file)
    assert page_file.read_text() == "as it was"

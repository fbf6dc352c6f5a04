"""The figures: orientation, labels, colour limits, no text over another, and files."""

import dataclasses
import itertools
import pickle
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from nightly import nightly

from clradar.compare.metrics import Metrics, compare
from clradar.errors import CompareError, ModelError, OutputError
from clradar.model import AntennaArray, DepthMap, ImageScale, Volume, VoxelGrid, Waveform
from clradar.plot import comparison_figure, image_figure, panels_figure, plane_of, save_figure

X_LEFT, ALPHA = "\N{LEFTWARDS ARROW} x (mm)", "\N{GREEK SMALL LETTER ALPHA}"
WIDE, DEEP = (-100, 100), (240, 360)
LONG = r"results/$\run$/2023-06-01_run_14, a file's name that goes on and on for many columns.h5"


def slab(x_mm: Any, y_mm: Any, z_mm: Any, step_mm: float = 4.0, at: Any = (20, 30, 300)) -> Volume:
    """A Gaussian blob at a place in millimetres, on a grid."""
    grid = VoxelGrid.from_extent(*(1e-3 * np.array(a) for a in (x_mm, y_mm, z_mm)), step_mm * 1e-3)
    x, y, z = (
        (axis * 1e3 - centre) / (4 * step_mm)
        for axis, centre in zip((grid.x_m, grid.y_m, grid.z_m), at, strict=True)
    )
    power = z[:, None, None] ** 2 + y[:, None] ** 2 + x**2
    return Volume(np.exp(-power).astype(np.complex64), grid)


def blob(x_mm: float = 20.0, y_mm: float = 30.0, z_mm: float = 300.0, step: float = 4.0) -> Volume:
    return slab(WIDE, WIDE, (260, 340), step, (x_mm, y_mm, z_mm))


FAR = slab((-1000, 1000), (-800, 800), (2500, 3500), 50.0, (200, 300, 3000))


def drawn(axes: Any) -> np.ma.MaskedArray:
    """The values of the mesh in `axes`, [y, x]."""
    return axes.collections[0].get_array()


def brightest_at(figure: Figure) -> tuple[float, float]:
    """The coordinates in which the first picture is brightest, as labelled."""
    axes = figure.axes[0]
    row, column = np.unravel_index(drawn(axes).argmax(), drawn(axes).shape)
    mesh: Any = axes.collections[0]
    corners = mesh.get_coordinates()[row : row + 2, column : column + 2].reshape(-1, 2)
    x, y = corners.mean(axis=0)
    return round(float(x), 6), round(float(y), 6)


def texts(figure: Figure) -> list[str]:
    return [t.get_text() for t in figure.texts]


def assert_legible(figure: Figure) -> None:
    """No text is over another or off the page."""
    figure.draw_without_rendering()
    hidden = set()
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        reach = 1e-9 * (high - low)
        hidden |= {
            id(label)
            for tick in axis.get_major_ticks()
            if not low - reach <= tick.get_loc() <= high + reach
            for label in (tick.label1, tick.label2)
        }
    boxes = [
        (t.get_text(), t.get_window_extent())
        for t in figure.findobj(Text)
        if t.get_text() and t.get_visible() and id(t) not in hidden
    ]
    page, touch = figure.bbox, figure.dpi / 72  # boxes include the font's line spacing
    for text, box in boxes:
        assert min(box.x0, box.y0) >= 0, text
        assert box.x1 <= page.x1 + 1, text  # a pixel
        assert box.y1 <= page.y1 + 1, text
    for (text_a, a), (text_b, b) in itertools.combinations(boxes, 2):
        beside = a.x1 <= b.x0 + touch or b.x1 <= a.x0 + touch
        assert beside or a.y1 <= b.y0 + touch or b.y1 <= a.y0 + touch, (text_a, text_b)


@pytest.mark.parametrize("count", [4, *nightly([1])])
def test_columns_of_a_comparison(count):
    labels = [f"{ALPHA} = {i / 10}" for i in range(count)]
    figure = comparison_figure(
        blob(z_mm=290.0), [(label, blob(z_mm=320.0)) for label in labels], metrics=()
    )
    columns = count + 1
    assert len(pickle.loads(pickle.dumps(figure)).axes) == len(figure.axes) == 2 * columns + 2
    assert [a.get_title() for a in figure.axes[:columns]] == ["Measurement", *labels]
    above, below = (figure.axes[row * columns].get_position() for row in (0, 1))
    assert 0 < (above.y0 - below.y1) * figure.get_figheight() < 0.2  # inches between the rows
    for i, axes in enumerate(figure.axes[: 2 * columns]):
        assert axes.get_xlabel() == (X_LEFT if i >= columns else "")
        assert axes.get_ylabel() == ("y (mm)" if i % columns == 0 else "")
        limits = (*axes.get_xlim(), *axes.get_ylim(), axes.get_aspect())
        # Half a voxel of 4 mm beyond the outer centres.
        np.testing.assert_allclose(limits, (102, -102, -102, 102, 1.0), atol=1e-9)
    assert [a.get_ylabel() for a in figure.axes[-2:]] == ["below maximum (dB)", "depth z (mm)"]
    for axes in figure.axes[columns : 2 * columns]:  # one scale of depth, of all of them
        np.testing.assert_allclose(axes.collections[0].get_clim(), (290, 320), atol=1.0)


def test_caption():
    images = [blob(), blob(0.0), blob(-60.0)]
    given = Metrics(0.654, 0.876, 0.5, 0.25, float("nan"), 0.0123, 0.9)
    figure = comparison_figure(
        images[0], [("a", images[1])], metrics=[given], measured_label="Synthetic"
    )
    for expected in ("0.654", "0.876", "0.500", "0.250", "n/a", "12.30", "900.00"):
        assert expected in texts(figure)
    assert "depth RMSE (mm)" in texts(figure)
    assert figure.axes[0].get_title() == "Synthetic"
    computed = comparison_figure(images[0], [("a", images[1]), ("b", images[2])])
    for image in images[1:]:
        value = 1e3 * compare(images[0], image).chamfer_simulated_to_measured_m
        assert f"{value:.2f}" in texts(computed)
    assert texts(comparison_figure(images[0], [("a", images[1])], metrics=())) == []


def random_map(n_x: int, n_y: int, step_m: float = 4e-3, first_m: float = -0.1) -> DepthMap:
    rng = np.random.default_rng(0)
    values = rng.uniform(0.26, 0.34, (n_y, n_x)), rng.uniform(0.2, 1, (n_y, n_x))
    return DepthMap(*values, first_m + step_m * np.arange(n_x), first_m + step_m * np.arange(n_y))


@pytest.mark.parametrize(
    ("image", "count"),
    [
        (random_map(51, 51), 4),
        *nightly([(random_map(51, 51), 12), (random_map(51, 51), 1), (FAR.depth_map(), 1),
                  (random_map(51, 1), 1), (random_map(51, 20), 4), (random_map(20, 51), 4),
                  (random_map(12, 12, 1.8e-4, 12.345), 2),
                  (random_map(12, 12, 1.8e-4, 12.345), 6), (random_map(12, 12, 0.28, 0.0), 6)]),
    ],
)  # fmt: skip
def test_no_text_over_another_or_off_the_page(image, count):
    metrics = [Metrics(0.5, -0.123, 0.987, 0.5, float("nan"), 0.1234, 0.2)] * count
    columns = [(label, image) for label in (LONG, *(f"{ALPHA} = {i}" for i in range(count - 1)))]
    assert_legible(comparison_figure(image, columns, metrics=metrics, differences=True))
    assert_legible(image_figure(image, LONG))


ZERO = Volume(np.zeros_like(blob().data), blob().grid)
METRICS = compare(blob(), blob())
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "zero": (lambda: image_figure(ZERO), r"image: .*0 everywhere"),
    "zero beside": (lambda: comparison_figure(blob(), [("b", ZERO)]), "image 'b': .*0 everywhere"),
    "none beside": (lambda: comparison_figure(blob(), []), "at least one simulated image"),
    "more metrics": (
        lambda: comparison_figure(blob(), [("a", blob())], metrics=[METRICS, METRICS]),
        r"metrics of all simulated images, at \[15.0\] dB, got \[15.0, 15.0\] dB",
    ),
    "other metrics": (
        lambda: comparison_figure(
            blob(), [("a", blob())], metrics=[METRICS], dynamic_range_db=20.0
        ),
        r"at \[20.0\] dB, got \[15.0\] dB",
    ),
    "pixels": (lambda: comparison_figure(blob(), [("a", blob(step=5.0))]), "same pixels"),
    "panels": (
        lambda: panels_figure([[("a", None), ("b", random_zero())]]), "one image that is not zero"
    ),
    "line": (lambda: image_figure(slab((20, 20), (30, 30), DEEP)), "a plane .* got 1 x 1 x"),
    "view": (lambda: image_figure(blob(), view="zx"), "one of 'xy', 'xz', 'yz', got 'zx'"),
    "view of a map": (lambda: image_figure(blob().depth_map(), view="xz"), "view: expected 'xy'"),
    "all of a map": (lambda: image_figure(blob().depth_map(), view="all"), "expected a volume"),
    "plane": (lambda: plane_of(blob(), "z", 0.35), "expected z from 260 to 340 mm, got 350"),
    "scale": (lambda: image_figure(blob(), dbsm=True), "absolute scale"),
    "scale of a map": (lambda: image_figure(blob().depth_map(), dbsm=True), "expected a Volume"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_drawn_is_refused(name):
    draw, message = REFUSED[name]
    with pytest.raises((CompareError, ModelError), match=message):
        draw()


def random_zero() -> DepthMap:
    image = random_map(9, 9)
    return DepthMap(image.depth_m, 0 * image.amplitude, image.x_m, image.y_m)


def test_panels_are_in_rows_with_their_own_axes():
    near, far = blob().depth_map(), blob(x_mm=-40.0).depth_map()
    rows = [[("one $\nsecond line", near), ("none", None)], [("three", far), ("0", random_zero())]]
    figure = panels_figure(rows, "All")
    *panels, bar = figure.axes
    titles = [a.get_title() for a in panels]
    assert titles == ["one $\nsecond line", "none", "three", "0"]
    tops = [a.get_position().y1 for a in panels]
    assert tops == pytest.approx([tops[0], tops[0], tops[2], tops[2]])
    assert tops[0] > tops[2]
    for axes, image in ((panels[0], near), (panels[2], far)):
        assert axes.xaxis_inverted()
        assert drawn(axes).max() == 0.0  # each relative to its own maximum
        assert np.array_equal(~drawn(axes).mask, image.mask)
    assert not panels[1].collections
    assert not panels[3].collections
    assert bar.get_ylabel() == "below maximum (dB)"
    assert texts(figure) == ["All"]


@pytest.mark.parametrize(
    ("extents", "view", "labels", "at", "title"),
    [
        ((WIDE, (26, 34), DEEP), None, "xz", (20, 300), "Amplitude, maximum over y"),
        (((20, 20), WIDE, DEEP), None, "zy", (300, 30), "Amplitude at x = 20 mm"),
        ((WIDE, (14, 46), DEEP), "xy", "xy", (20, 30), "Amplitude, maximum over depth"),
        *nightly(
            [
                ((WIDE, (30, 30), DEEP), None, "xz", (20, 300), "Amplitude at y = 30 mm"),
                ((WIDE, WIDE, (300, 300)), None, "xy", (20, 30), "Amplitude at z = 300 mm"),
                ((WIDE, WIDE, DEEP), None, "xy", (20, 30), "Amplitude, maximum over depth"),
                ((WIDE, WIDE, DEEP), "xz", "xz", (20, 300), "Amplitude, maximum over y"),
                ((WIDE, WIDE, DEEP), "yz", "zy", (300, 30), "Amplitude, maximum over x"),
            ]
        ),
    ],
)
def test_pictures_are_projected_along_the_thin_axis_or_that_of_the_view(
    extents, view, labels, at, title
):
    figure = image_figure(slab(*extents, step_mm=2.0), LONG, view=view)
    axes = figure.axes[0]
    names = [axes.get_xlabel().lstrip("\N{LEFTWARDS ARROW} "), axes.get_ylabel()]
    assert names == [f"{name} (mm)" for name in labels]
    assert brightest_at(figure) == at
    assert axes.get_title() == title
    # x increases to the left in every view, z to the right and upwards.
    assert axes.xaxis_inverted() == (labels[0] == "x")
    assert not axes.yaxis_inverted()
    # A slice is no strip of one pixel: the drawn picture is at least an eighth as high as wide.
    figure.draw_without_rendering()
    box = axes.get_window_extent()
    assert min(box.height / box.width, box.width / box.height) > 1 / 8
    if len(figure.axes) == 4:  # the colour is the coordinate of the maximum along the third axis
        third = {"xy": 300.0, "xz": 30.0, "zy": 20.0}[labels]
        assert drawn(figure.axes[1]).mean() == pytest.approx(third, abs=0.1)
    assert_legible(figure)


def test_levels_as_radar_cross_sections():
    array = AntennaArray([[0, 0, 0]], [[0.01, 0, 0]])
    scaled = dataclasses.replace(blob(), scale=ImageScale(array, Waveform([77e9]), [1.0]))
    figure = image_figure(scaled, dbsm=True, dynamic_range_db=20.0)
    top_dbsm = float(scaled.rcs_dbsm().max())
    axes = figure.axes[0]
    assert np.max(drawn(axes)) == pytest.approx(top_dbsm, abs=1e-4)  # of float32
    assert axes.collections[0].get_clim()[0] == pytest.approx(top_dbsm - 20, abs=1e-4)
    assert "radar cross section (dBsm)" in [a.get_ylabel() for a in figure.axes]


@pytest.mark.parametrize(
    ("axis", "place_m", "index"), [("x", 0.0201, 30), ("y", None, 32), ("z", 0.2999, 10)]
)
def test_planes_are_the_nearest_voxels_or_those_of_the_maximum(axis, place_m, index):
    volume = blob()
    plane = plane_of(volume, axis, place_m)
    assert np.array_equal(plane.data, volume.data.take([index], "zyx".index(axis)))
    assert getattr(plane.grid, f"{axis}_m").tolist() == [getattr(volume.grid, f"{axis}_m")[index]]
    assert len(image_figure(plane).axes) == 2


@pytest.mark.filterwarnings("ignore:compare. an overlap of:clradar.ClradarWarning")
def test_disagreement_is_drawn_with_rings_around_unmatched_objects():
    two = Volume(blob().data + 0.8 * blob(-60.0, -60.0).data, blob().grid)
    figure = comparison_figure(two, [("one", blob()), ("two", two)], differences=True)
    one, both = figure.axes[6:8]
    mesh, ring = one.collections
    assert ring.get_offsets().tolist() == [pytest.approx([-60.0, -60.0])]
    assert len(both.collections) == 1
    level = mesh.get_array()
    assert level[10, 10] > 12.0  # [row, column] of (-60, -60) mm
    assert level[32, 30] == pytest.approx(0.0, abs=0.1)
    assert level.mask[0, 0]
    assert one.xaxis_inverted()
    assert figure.axes[-1].get_ylabel() == "unmatched by (dB)"
    assert "ring: object missing" in "".join(texts(figure))
    assert "dotted" not in "".join(texts(figure))
    # The other way round it is surplus: the same place, the other sign, another ring.
    turned = comparison_figure(blob(), [("two", two)], differences=True)
    mesh, other = turned.axes[4].collections
    assert mesh.get_array()[10, 10] < -12.0
    assert other.get_linestyles() != ring.get_linestyles()


def small_figure() -> Figure:
    figure = Figure((2, 1))
    figure.subplots().set_title(r"price: $3 \of $5", parse_math=False)
    return figure


def test_files_are_the_same_every_time(tmp_path, monkeypatch):
    before = "matplotlib.pyplot" in sys.modules  # it keeps every figure alive
    one, two = small_figure(), small_figure()
    for suffix in (".PNG", ".pdf", ".svg"):
        monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
        first = save_figure(one, tmp_path / f"first{suffix}")
        monkeypatch.setenv("SOURCE_DATE_EPOCH", "1")  # another date, were there one in the file
        second = save_figure(two, str(tmp_path / f"second{suffix}"))
        assert first.read_bytes() == second.read_bytes()
        assert b"Matplotlib" not in first.read_bytes()[:2000]
    assert ("matplotlib.pyplot" in sys.modules) == before


@pytest.mark.parametrize("name", ["a.jpg", "missing/a.png", "there.png"])
def test_targets_that_cannot_be_written(tmp_path, name):
    (tmp_path / "there.png").write_bytes(b"precious")
    with pytest.raises(OutputError, match=r"expected|exists already"):
        save_figure(Figure(), tmp_path / name, force=name != "there.png")
    assert (tmp_path / "there.png").read_bytes() == b"precious"
    assert [p.name for p in tmp_path.iterdir()] == ["there.png"]

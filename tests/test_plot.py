"""The figures: orientation, labels, colour limits, no text over another, and safe files."""

from __future__ import annotations

import dataclasses
import errno
import itertools
import os
import stat
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from systems import posix_only

from clradar.compare import Metrics, compare
from clradar.errors import CompareError, ModelError, OutputError
from clradar.model import AntennaArray, DepthMap, ImageScale, Volume, VoxelGrid, Waveform
from clradar.plot import (
    AMPLITUDE_BACKGROUND,
    DEPTH_BACKGROUND,
    comparison_figure,
    disagreement_figure,
    image_figure,
    panels_figure,
    plane_of,
    save_figure,
)

X_LEFT = "\N{LEFTWARDS ARROW} x (mm)"

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"


def blob(x_mm: float = 20.0, y_mm: float = 30.0, z_mm: float = 300.0, step: float = 4e-3) -> Volume:
    """One Gaussian blob; the default grid is 51 x 51 x 21 voxels, as wide as the usual one."""
    grid = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), step)
    x, y, z = (
        (axis * 1e3 - centre) / 15.0
        for axis, centre in zip((grid.x_m, grid.y_m, grid.z_m), (x_mm, y_mm, z_mm), strict=True)
    )
    power = z[:, None, None] ** 2 + y[:, None] ** 2 + x**2
    return Volume(np.exp(-power).astype(np.complex64), grid)


def drawn(axes: Any) -> np.ma.MaskedArray:
    """The values of the one mesh in `axes`, [y, x]."""
    (mesh,) = axes.collections
    return mesh.get_array()


def texts(figure: Figure) -> list[str]:
    return [t.get_text() for t in figure.texts]


def visible_texts(figure: Figure) -> list[Any]:
    from matplotlib.text import Text

    return [t for t in figure.findobj(Text) if t.get_text() and t.get_visible()]


def test_images_are_drawn_in_the_radar_s_view() -> None:
    figure = comparison_figure(blob(), [("one", blob())])
    for axes in figure.axes[:4]:
        left, right = axes.get_xlim()
        bottom, top = axes.get_ylim()
        # Half a voxel of 4 mm beyond the outer centres.
        np.testing.assert_allclose((left, right, bottom, top), (102, -102, -102, 102), atol=1e-9)
        assert axes.get_aspect() == 1.0
    figure.draw_without_rendering()
    # The blob at x = +20 mm, y = +30 mm is left of the middle and above it.
    axes = figure.axes[0]
    column, row = axes.transData.transform((20.0, 30.0))
    box = axes.get_window_extent()
    assert column < (box.x0 + box.x1) / 2
    assert row > (box.y0 + box.y1) / 2


def test_values_lie_where_their_pixels_are() -> None:
    axes = image_figure(blob(20.0, -40.0)).axes[0]
    row, column = np.unravel_index(drawn(axes).argmax(), drawn(axes).shape)
    mesh: Any = axes.collections[0]
    corners = mesh.get_coordinates()[row : row + 2, column : column + 2].reshape(-1, 2)
    np.testing.assert_allclose(corners.mean(axis=0), (20.0, -40.0), atol=1e-9)


@pytest.mark.parametrize("count", [1, 4])
def test_columns_of_a_comparison(count: int) -> None:
    labels = [f"{ALPHA} = {i / 10}" for i in range(count)]
    figure = comparison_figure(blob(), [(label, blob()) for label in labels])
    columns = count + 1
    assert len(figure.axes) == 2 * columns + 2
    assert [a.get_title() for a in figure.axes[:columns]] == ["Measurement", *labels]
    for i, axes in enumerate(figure.axes[: 2 * columns]):
        assert axes.get_xlabel() == (X_LEFT if i >= columns else "")
        assert axes.get_ylabel() == ("y (mm)" if i % columns == 0 else "")
    assert [a.get_ylabel() for a in figure.axes[-2:]] == ["below maximum (dB)", "depth z (mm)"]


def test_image_figure() -> None:
    figure = image_figure(blob(), r"price: $3 \of $5")
    assert len(figure.axes) == 4
    assert [a.get_xlabel() for a in figure.axes] == [X_LEFT, X_LEFT, "", ""]
    labels = ["y (mm)", "y (mm)", "below maximum (dB)", "depth z (mm)"]
    assert [a.get_ylabel() for a in figure.axes] == labels
    assert all(a.xaxis_inverted() for a in figure.axes[:2])
    assert texts(figure) == [r"price: $3 \of $5"]
    figure.draw_without_rendering()
    assert texts(image_figure(blob().depth_map())) == []


def test_amplitude_is_in_db_with_fixed_limits() -> None:
    figure = comparison_figure(blob(), [("weaker", Volume(0.01 * blob().data, blob().grid))])
    for axes in figure.axes[:2]:
        (mesh,) = axes.collections
        assert mesh.get_clim() == (-15.0, 0.0)
        assert drawn(axes).max() == 0.0
        assert drawn(axes).min() > -15.0
        assert drawn(axes).mask.any()
    assert image_figure(blob(), dynamic_range_db=30.0).axes[0].collections[0].get_clim()[0] == -30.0


def test_all_depths_share_their_limits() -> None:
    figure = comparison_figure(blob(z_mm=290.0), [("far", blob(z_mm=320.0))])
    limits = [a.collections[0].get_clim() for a in figure.axes[2:4]]
    # The parabola finds 290 and 320 mm, up to its error on a Gaussian of three voxels.
    assert limits[0] == limits[1]
    np.testing.assert_allclose(limits[0], (290.0, 320.0), atol=1.0)
    np.testing.assert_allclose(drawn(figure.axes[3]).mean(), 320.0, atol=0.5)


def test_stray_depths_do_not_stretch_the_scale() -> None:
    x_m = np.arange(20) * 1e-3
    depth_m = np.full((20, 20), 0.3)
    depth_m[0, 0] = 0.4
    image = DepthMap(depth_m, np.ones((20, 20)), x_m, x_m)
    figure = image_figure(image)
    assert figure.axes[1].collections[0].get_clim() == (299.0, 301.0)
    # It is marked on the colour bar: an arrow at the upper end, none at the lower.
    mesh: Any = figure.axes[1].collections[0]
    assert mesh.colorbar.extend == "max"


def test_backgrounds_are_neutral_and_not_in_the_scale() -> None:
    from matplotlib.colors import to_rgb

    figure = image_figure(blob())
    for axes, colour in zip(figure.axes, (AMPLITUDE_BACKGROUND, DEPTH_BACKGROUND), strict=False):
        (mesh,) = axes.collections
        background = np.array(to_rgb(colour))
        assert np.ptp(background) == 0
        np.testing.assert_allclose(mesh.cmap.get_bad()[:3], background)
        np.testing.assert_allclose(to_rgb(axes.get_facecolor()), background)
        scale = mesh.cmap(np.linspace(0, 1, 256))[:, :3]
        # A tenth of full scale is a visible difference.
        assert np.abs(scale - background).max(axis=1).min() > 0.1


def test_caption() -> None:
    images = [blob(), blob(0.0), blob(-60.0)]
    given = Metrics(0.654, 0.876, 0.5, 0.25, float("nan"), 0.0123, 0.9)
    figure = comparison_figure(images[0], [("a", images[1])], metrics=[given])
    for expected in ("0.654", "0.876", "0.500", "0.250", "n/a", "12.30", "900.00"):
        assert expected in texts(figure)
    assert "depth RMSE (mm)" in texts(figure)
    computed = comparison_figure(images[0], [("a", images[1]), ("b", images[2])])
    for image in images[1:]:
        value = 1e3 * compare(images[0], image).chamfer_simulated_to_measured_m
        assert f"{value:.2f}" in texts(computed)
    without = comparison_figure(images[0], [("a", images[1])], metrics=())
    assert texts(without) == []
    assert without.get_figheight() < figure.get_figheight()


LONG = r"results/$\run$/2023-06-01_run_14, a file's name that goes on and on for many columns.h5"


@pytest.mark.parametrize(
    ("shape", "count"),
    [((51, 51), 1), ((51, 51), 12), ((51, 20), 4), ((20, 51), 4), ((51, 1), 1)],
)
def test_no_text_over_another_or_off_the_page(shape: tuple[int, int], count: int) -> None:
    n_x, n_y = shape
    x_m, y_m = (4e-3 * (np.arange(n) - n // 2) for n in shape)
    rng = np.random.default_rng(0)
    image = DepthMap(rng.uniform(0.26, 0.34, (n_y, n_x)), rng.uniform(0.2, 1, (n_y, n_x)), x_m, y_m)
    metrics = [Metrics(0.5, -0.123, 0.987, 0.5, float("nan"), 0.1234, 0.2)] * count
    labels = [LONG, *(f"{ALPHA} = {i}" for i in range(count - 1))]
    columns = [(label, image) for label in labels]
    for differences in (False, True):
        assert_legible(comparison_figure(image, columns, metrics=metrics, differences=differences))
    assert_legible(image_figure(image, LONG))
    assert_legible(disagreement_figure(image, image, title=LONG))


def assert_legible(figure: Figure) -> None:
    figure.draw_without_rendering()
    boxes = [(t.get_text(), t.get_window_extent()) for t in visible_texts(figure)]
    page = figure.bbox
    for text, box in boxes:
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= page.x1, text
        assert box.y1 <= page.y1, text
    for (text_a, a), (text_b, b) in itertools.combinations(boxes, 2):
        # Boxes include the font's line spacing: neighbouring lines may touch, by under a point.
        touch = figure.dpi / 72
        apart = (
            a.x1 <= b.x0 + touch
            or b.x1 <= a.x0 + touch
            or a.y1 <= b.y0 + touch
            or b.y1 <= a.y0 + touch
        )
        assert apart, (text_a, text_b)


def test_uneven_and_single_axes() -> None:
    x_m = np.array([0.0, 1.0, 3.0]) * 1e-3
    image = DepthMap(np.full((1, 3), 0.3), np.ones((1, 3)), x_m, np.array([0.0]))
    mesh: Any = image_figure(image).axes[0].collections[0]
    coordinates = mesh.get_coordinates()
    np.testing.assert_allclose(coordinates[0, :, 0], [-0.5, 0.5, 2.0, 4.0], atol=1e-12)
    np.testing.assert_allclose(coordinates[:, 0, 1], [-0.5, 0.5], atol=1e-12)


def test_images_and_metrics_that_do_not_fit_are_refused() -> None:
    zero = Volume(np.zeros_like(blob().data), blob().grid)
    with pytest.raises(CompareError, match=r"image: .*0 everywhere"):
        image_figure(zero)
    with pytest.raises(CompareError, match=r"simulated image 'b': .*0 everywhere"):
        comparison_figure(blob(), [("a", blob()), ("b", zero)])
    with pytest.raises(CompareError, match="at least one simulated image"):
        comparison_figure(blob(), [])
    metrics = compare(blob(), blob())
    with pytest.raises(CompareError, match="metrics for 1 simulated images, got 2"):
        comparison_figure(blob(), [("a", blob())], metrics=[metrics, metrics])
    with pytest.raises(CompareError, match="metrics at 20 dB, got metrics at 15 dB"):
        comparison_figure(blob(), [("a", blob())], metrics=[metrics], dynamic_range_db=20.0)
    with pytest.raises(CompareError, match="same pixels"):
        comparison_figure(blob(), [("a", blob(step=5e-3))])


def test_no_pyplot() -> None:
    """pyplot keeps every figure alive and may open windows."""
    before = "matplotlib.pyplot" in sys.modules
    comparison_figure(blob(), [("a", blob())]).draw_without_rendering()
    assert ("matplotlib.pyplot" in sys.modules) == before


def small_figure() -> Figure:
    figure = image_figure(blob(), "a blob")
    figure.set_dpi(40)
    return figure


@pytest.fixture(scope="module")
def figure() -> Figure:
    return small_figure()


@pytest.mark.parametrize("suffix", [".PNG", ".pdf", ".svg"])
def test_files_are_the_same_every_time(
    tmp_path: Path, figure: Figure, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = save_figure(figure, tmp_path / f"first{suffix}")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1")  # another date, were there one in the file
    second = save_figure(small_figure(), str(tmp_path / f"second{suffix}"))
    assert first.read_bytes() == second.read_bytes()
    assert first == tmp_path / f"first{suffix}"
    assert b"Matplotlib" not in first.read_bytes()[:2000]
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"first{suffix}", f"second{suffix}"]


def test_files_have_the_permissions_of_the_umask(tmp_path: Path, figure: Figure) -> None:
    reference = tmp_path / "reference"
    reference.touch()
    saved = save_figure(figure, tmp_path / "a.png")
    assert stat.S_IMODE(saved.stat().st_mode) == stat.S_IMODE(reference.stat().st_mode)


@posix_only
def test_the_longest_name_that_a_folder_takes(tmp_path: Path, figure: Figure) -> None:
    longest = "a" * (os.pathconf(tmp_path, "PC_NAME_MAX") - 4) + ".png"
    assert save_figure(figure, tmp_path / longest).is_file()
    with pytest.raises(OutputError, match="cannot be written"):
        save_figure(figure, tmp_path / ("a" + longest))


def test_nothing_is_overwritten_without_force(tmp_path: Path, figure: Figure) -> None:
    target = tmp_path / "a.png"
    target.write_bytes(b"precious")
    with pytest.raises(OutputError, match=r"a\.png: exists already"):
        save_figure(figure, target)
    assert target.read_bytes() == b"precious"
    save_figure(figure, target, force=True)
    assert target.read_bytes().startswith(b"\x89PNG")
    dangling = tmp_path / "link.png"
    dangling.symlink_to(tmp_path / "nowhere.png")
    with pytest.raises(OutputError, match="exists already"):
        save_figure(figure, dangling)


def test_a_file_that_appears_during_the_write_is_kept(
    tmp_path: Path, figure: Figure, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.png"
    monkeypatch.setattr(os, "fsync", lambda _: target.write_bytes(b"somebody else's"))
    with pytest.raises(OutputError, match="exists already"):
        save_figure(figure, target)
    assert target.read_bytes() == b"somebody else's"
    assert list(tmp_path.iterdir()) == [target]


def test_a_failed_write_leaves_what_was_there(
    tmp_path: Path, figure: Figure, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.png"
    target.write_bytes(b"precious")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match=r"a\.png: cannot be written: No space left"):
        save_figure(figure, target, force=True)
    assert target.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.txt", "missing/a.png", "folder.png"])
def test_targets_that_cannot_be_written(tmp_path: Path, figure: Figure, name: str) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OutputError, match="expected"):
        save_figure(figure, tmp_path / name, force=True)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.png"]


def test_the_first_column_has_the_title_it_is_given() -> None:
    figure = comparison_figure(
        blob(), [("alpha 0", blob())], measured_label="Synthetic measurement"
    )
    assert figure.axes[0].get_title() == "Synthetic measurement"


def test_panels_are_in_rows_with_their_own_axes() -> None:
    near, far = blob().depth_map(), blob(x_mm=-40.0).depth_map()
    zero = DepthMap(far.depth_m, 0 * far.amplitude, far.x_m, far.y_m)
    figure = panels_figure(
        [[("one $", near), ("none", None)], [("three", far), ("0", zero)]], "All"
    )
    panels, bar = figure.axes[:4], figure.axes[4]
    assert [a.get_title() for a in panels] == ["one $", "none", "three", "0"]
    tops = [a.get_position().y1 for a in panels]
    assert tops == pytest.approx([tops[0], tops[0], tops[2], tops[2]])
    assert tops[0] > tops[2]
    for axes, image in ((panels[0], near), (panels[2], far)):
        left, right = axes.get_xlim()
        assert left > right  # x increases to the left
        values = drawn(axes)
        assert values.max() == 0.0  # each relative to its own maximum
        assert np.array_equal(~values.mask, image.mask)
    assert not panels[1].collections
    assert not panels[3].collections
    assert bar.get_ylabel() == "below maximum (dB)"
    assert "All" in texts(figure)
    figure.draw_without_rendering()
    with pytest.raises(CompareError, match="not zero"):
        panels_figure([[("a", None), ("b", zero)]])


def slab(x_mm: Any, y_mm: Any, z_mm: Any, step_mm: float = 4.0) -> Volume:
    """A point at (20, 30, 300) mm, or (0.2, 0.3, 3) m where z is in metres, on a grid."""
    grid = VoxelGrid.from_extent(*(1e-3 * np.array(a) for a in (x_mm, y_mm, z_mm)), step_mm * 1e-3)
    place = (20.0, 30.0, 300.0) if grid.z_m[0] < 1 else (200.0, 300.0, 3000.0)
    x, y, z = (
        (axis * 1e3 - centre) / (4 * step_mm)
        for axis, centre in zip((grid.x_m, grid.y_m, grid.z_m), place, strict=True)
    )
    power = z[:, None, None] ** 2 + y[:, None] ** 2 + x**2
    return Volume(np.exp(-power).astype(np.complex64), grid)


def labels_of(figure: Figure) -> list[str]:
    return [figure.axes[0].get_xlabel().lstrip("\N{LEFTWARDS ARROW} "), figure.axes[0].get_ylabel()]


def brightest_at(figure: Figure) -> tuple[float, float]:
    """The coordinates in which the first picture is brightest, as labelled."""
    axes = figure.axes[0]
    row, column = np.unravel_index(drawn(axes).argmax(), drawn(axes).shape)
    mesh: Any = axes.collections[0]
    corners = mesh.get_coordinates()[row : row + 2, column : column + 2].reshape(-1, 2)
    x, y = corners.mean(axis=0)
    return round(float(x), 6), round(float(y), 6)


WIDE, DEEP = (-100, 100), (240, 360)


@pytest.mark.parametrize(
    ("extents", "labels", "at", "panel"),
    [
        ((WIDE, (30, 30), DEEP), ["x (mm)", "z (mm)"], (20, 300), "Amplitude at y = 30 mm"),
        ((WIDE, (26, 34), DEEP), ["x (mm)", "z (mm)"], (20, 300), "Amplitude, maximum over y"),
        (((20, 20), WIDE, DEEP), ["z (mm)", "y (mm)"], (300, 30), "Amplitude at x = 20 mm"),
        ((WIDE, WIDE, (300, 300)), ["x (mm)", "y (mm)"], (20, 30), "Amplitude at z = 300 mm"),
        ((WIDE, WIDE, DEEP), ["x (mm)", "y (mm)"], (20, 30), "Amplitude, maximum over depth"),
        ((WIDE, (14, 46), DEEP), ["x (mm)", "y (mm)"], (20, 30), "Amplitude, maximum over depth"),
    ],
)
def test_pictures_are_projected_along_the_thin_axis(
    extents: Any, labels: list[str], at: tuple[float, float], panel: str
) -> None:
    figure = image_figure(slab(*extents, step_mm=2.0), "a slice")
    assert labels_of(figure) == labels
    assert brightest_at(figure) == at
    assert figure.axes[0].get_title() == panel
    # x increases to the left in every view, z to the right and upwards.
    assert figure.axes[0].xaxis_inverted() == (labels[0] == "x (mm)")
    assert not figure.axes[0].yaxis_inverted()
    # A slice is no strip of one pixel: the drawn picture is at least an eighth as high as wide.
    figure.draw_without_rendering()
    box = figure.axes[0].get_window_extent()
    assert min(box.height / box.width, box.width / box.height) > 1 / 8
    assert_legible(figure)


@pytest.mark.parametrize(
    ("view", "labels", "at", "depth"),
    [
        ("xy", ["x (mm)", "y (mm)"], (20, 30), "depth z (mm)"),
        ("xz", ["x (mm)", "z (mm)"], (20, 300), "y (mm)"),
        ("yz", ["z (mm)", "y (mm)"], (300, 30), "x (mm)"),
    ],
)
def test_the_view_can_be_chosen(view: str, labels: list[str], at: Any, depth: str) -> None:
    figure = image_figure(slab(WIDE, WIDE, DEEP, 10.0), view=view)
    assert labels_of(figure) == labels
    assert brightest_at(figure) == at
    assert figure.axes[3].get_ylabel() == depth
    # The colour is the coordinate of the maximum along the third axis.
    third = {"xy": 300.0, "xz": 30.0, "yz": 20.0}[view]
    np.testing.assert_allclose(drawn(figure.axes[1]).mean(), third, atol=0.1)
    assert_legible(figure)


def test_large_lengths_are_in_metres() -> None:
    far = slab((-1000, 1000), (-800, 800), (2500, 3500), 50.0)
    for view, labels, at in (
        ("xy", ["x (m)", "y (m)"], (0.2, 0.3)),
        ("xz", ["x (m)", "z (m)"], (0.2, 3.0)),
    ):
        figure = image_figure(far, view=view)
        assert labels_of(figure) == labels
        assert brightest_at(figure) == at
        assert_legible(figure)
    figure = image_figure(far)
    assert figure.axes[3].get_ylabel() == "depth z (m)"
    figure.draw_without_rendering()
    shown = [float(t.get_text()) for t in figure.axes[3].get_yticklabels() if t.get_text()]
    low, high = figure.axes[1].collections[0].get_clim()
    assert shown
    assert all(low <= 1e3 * label <= high for label in shown)
    assert_legible(comparison_figure(far, [("a", far)]))
    assert comparison_figure(far, [("a", far)]).axes[2].get_xlabel() == X_LEFT.replace("mm", "m")


@pytest.mark.parametrize("origin_mm", [0.0, 12_345.0])
def test_labels_of_neighbouring_ticks_do_not_touch(origin_mm: float) -> None:
    for width_mm in (2.0, 3100.0):
        x_m = (origin_mm + np.linspace(0, width_mm, 12)) * 1e-3
        image = DepthMap(np.full((12, 12), 1.5), np.ones((12, 12)), x_m, x_m)
        assert_legible(image_figure(image))
        assert_legible(comparison_figure(image, [(str(i), image) for i in range(6)]))


def test_a_line_of_voxels_is_a_curve() -> None:
    figure = image_figure(slab((20, 20), (30, 30), DEEP, 2.0), "a line", dynamic_range_db=20.0)
    (axes,) = figure.axes
    (curve,) = axes.lines
    assert labels_of(figure) == ["z (mm)", "below maximum (dB)"]
    assert axes.get_title() == "Amplitude at x = 20, y = 30 mm"
    assert curve.get_xdata()[np.argmax(curve.get_ydata())] == pytest.approx(300.0)
    assert axes.get_ylim()[0] == -20.0
    assert_legible(figure)
    across = image_figure(slab(WIDE, (30, 30), (300, 300), 2.0))
    assert across.axes[0].xaxis_inverted()


@pytest.mark.parametrize("shape", ["volume", "line"])
def test_levels_as_radar_cross_sections(shape: str) -> None:
    plain = blob() if shape == "volume" else slab((20, 20), (30, 30), DEEP, 2.0)
    array = AntennaArray([[0, 0, 0]], [[0.01, 0, 0]])
    image = dataclasses.replace(plain, scale=ImageScale(array, Waveform([77e9]), [1.0]))
    figure = image_figure(image, dbsm=True, dynamic_range_db=20.0)
    top_dbsm = float(image.rcs_dbsm().max())
    axes = figure.axes[0]
    values = drawn(axes) if shape == "volume" else axes.lines[0].get_ydata()
    assert values.max() == pytest.approx(top_dbsm, abs=1e-4)  # of float32
    limits = axes.collections[0].get_clim() if shape == "volume" else axes.get_ylim()
    assert limits[0] == pytest.approx(top_dbsm - 20, abs=1e-4)
    assert "radar cross section (dBsm)" in [a.get_ylabel() for a in figure.axes]
    assert axes.get_title().startswith("Radar cross section")
    if shape == "volume":  # a curve has ticks outside, which are not drawn
        assert_legible(figure)
    with pytest.raises(ModelError, match="absolute scale"):
        image_figure(plain, dbsm=True)
    with pytest.raises(CompareError, match="expected a Volume"):
        image_figure(blob().depth_map(), dbsm=True)


def test_all_three_views_are_below_one_maximum_in_one_unit() -> None:
    volume = blob()
    far = Volume(volume.data, VoxelGrid([-0.1, -0.1, 0.96], [4e-3] * 3, volume.grid.counts))
    for image, unit in ((volume, "mm"), (far, "m")):
        *panels, _ = image_figure(image, view="all").axes
        names = [(panel.get_xlabel()[-len(unit) - 4 :], panel.get_ylabel()) for panel in panels]
        assert names == [(f"{a} ({unit})", f"{b} ({unit})") for a, b in ("xy", "xz", "zy")]
        assert [drawn(panel).max() for panel in panels] == [0.0] * 3
        assert [drawn(panel).shape for panel in panels] == [(51, 51), (21, 51), (51, 21)]


def test_planes_are_the_nearest_voxels_or_those_of_the_maximum() -> None:
    volume = blob()
    for axis, place_m, index in (("x", 0.0201, 30), ("y", None, 32), ("z", 0.2999, 10)):
        plane = plane_of(volume, axis, place_m)
        number = "zyx".index(axis)
        assert np.array_equal(plane.data, volume.data.take([index], number))
        assert getattr(plane.grid, f"{axis}_m").tolist() == [
            getattr(volume.grid, f"{axis}_m")[index]
        ]
        assert len(image_figure(plane).axes) == 2
    with pytest.raises(CompareError, match="expected z from 260 to 340 mm, got 350"):
        plane_of(volume, "z", 0.35)


def test_what_has_no_picture_or_no_such_view_is_refused() -> None:
    with pytest.raises(
        CompareError, match=r"more than one voxel.* x = 20, y = 30, z = 300 mm.* 1$"
    ):
        image_figure(slab((20, 20), (30, 30), (300, 300)))
    with pytest.raises(ModelError, match="view: expected one of 'xy', 'xz', 'yz', got 'zx'"):
        image_figure(blob(), view="zx")
    with pytest.raises(CompareError, match="view: expected 'xy'"):
        image_figure(blob().depth_map(), view="xz")


@pytest.mark.filterwarnings("ignore:compare. an overlap of:clradar.ClradarWarning")
def test_disagreement_is_drawn_with_rings_around_unmatched_objects() -> None:
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
    # The other way round it is surplus: the same place, the other sign, another ring.
    turned = disagreement_figure(blob(), two)
    mesh, other = turned.axes[0].collections
    assert mesh.get_array()[10, 10] < -12.0
    assert other.get_linestyles() != ring.get_linestyles()
    assert turned.axes[1].get_title() == "Depth, simulated minus measured"


def test_disagreement_after_a_motion() -> None:
    back = np.eye(4)
    back[0, 3] = 20e-3
    figure = disagreement_figure(blob(), blob(0.0, 30.0), back)
    (mesh,) = figure.axes[0].collections
    assert np.abs(mesh.get_array().compressed()).max() < 1.0
    assert len(disagreement_figure(blob(), blob(0.0, 30.0, 320.0), back).axes[0].collections) == 3

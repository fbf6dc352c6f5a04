"""Cached products: where each pixel lands, in both directions, and what damaged files end in."""

from __future__ import annotations

import json
import os
import re
import struct
import tracemalloc
import zlib
from pathlib import Path

import maroon_products as made
import numpy as np
import pytest
from systems import posix_only

import clradar
from clradar.errors import MeasurementError, ModelError, OutputError
from measurement_io import write_products
from measurement_io.maroon import ply_points, png16
from measurement_io.maroon.calibration_file import read_calibration_file, read_frame_entry
from measurement_io.maroon.products import (
    read_amplitude_volume,
    read_depth_map,
    read_max_projection,
    read_points,
)

TARGETS = [(0.092, 0.024, 0.30, 900.0), (-0.06, -0.054, 0.28, 600.0), (0.02, 0.037, 0.32, 400.0)]
"""x, y, z of radar space on voxels of the scene, and amplitude: no two share |x|, |y| or z."""

EXACT_M = 1e-12
"""Axes are a few float64 operations on numbers below 1 m."""

HALF_MM_M = 0.5e-3 + EXACT_M
"""Rounding to whole millimetres."""

N_FREQ = 2


@pytest.fixture(scope="module")
def scene() -> made.RadarScene:
    return made.scene(TARGETS)


@pytest.fixture
def radar(tmp_path: Path, scene: made.RadarScene) -> Path:
    folder = tmp_path / "30" / f"radar_72.0_82.0_{N_FREQ}"
    made.write_products(folder, 0, scene)
    return folder


READERS = {
    "depth": read_depth_map,
    "maxproj": read_max_projection,
    "volume": read_amplitude_volume,
    "xyz": read_points,
}


def refused(radar: Path, product: str, number: int = 0) -> str:
    with pytest.raises(MeasurementError) as caught:
        READERS[product](radar, number)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def outcome(radar: Path, product: str) -> str | None:
    """Return the message of the one error that may come, None if there is a product."""
    try:
        READERS[product](radar, 0)
    except MeasurementError as error:
        return str(error)
    return None


def change_entry(radar: Path, change) -> None:
    content = json.loads((radar / "calibration.json").read_text())
    change(content["000000"])
    (radar / "calibration.json").write_text(json.dumps(content))


def nearest(axis: np.ndarray, value: float) -> int:
    return int(np.abs(axis - value).argmin())


# ---- where things land


def test_depth_map_lands_in_the_antenna_frame(radar, scene):
    depth = read_depth_map(radar, 0)
    np.testing.assert_allclose(depth.x_m, -scene.x_m[::-1], rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(depth.y_m, scene.y_m, rtol=0, atol=EXACT_M)
    for x, y, z, strength in TARGETS:
        i, j = nearest(depth.y_m, y), nearest(depth.x_m, -x)
        assert abs(depth.depth_m[i, j] - z) <= HALF_MM_M
        assert depth.amplitude[i, j] == int(strength + 2)  # the floor of the scene; cut off
        # Every mirror image of a target is empty.
        for dx, dy in ((x, y), (-x, -y), (x, -y)):
            assert np.isnan(depth.depth_m[nearest(depth.y_m, dy), nearest(depth.x_m, dx)])
    _, expected = scene.strongest()
    np.testing.assert_allclose(depth.depth_m, expected[::-1].T, rtol=0, atol=HALF_MM_M)
    assert depth.dynamic_range_db == made.DEPTH_CUT_DB


def test_max_projection_lands_in_the_antenna_frame(radar, scene):
    image = read_max_projection(radar, 0)
    peak, _ = scene.strongest()
    assert np.array_equal(image.amplitude, np.floor(peak[::-1].T))
    np.testing.assert_allclose(image.x_m, -scene.x_m[::-1], rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(image.y_m, scene.y_m, rtol=0, atol=EXACT_M)


@pytest.mark.parametrize("kind", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_volume_and_points_land_in_the_antenna_frame(tmp_path, scene, kind):
    radar = tmp_path / "radar_72.0_82.0_2"
    made.write_products(radar, 0, scene, ply_kind=kind)
    volume = read_amplitude_volume(radar, 0)
    # One of 255 steps between the scene's extremes, rounded to the nearest.
    half_step = 0.5 * np.ptp(scene.amplitude) / 255 * (1 + 1e-5)
    expected = scene.amplitude[::-1].transpose(2, 1, 0)
    np.testing.assert_allclose(volume.amplitude, expected, rtol=0, atol=half_step)
    np.testing.assert_allclose(volume.grid.x_m, -scene.x_m[::-1], rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(volume.grid.y_m, scene.y_m, rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(volume.grid.z_m, scene.z_m, rtol=0, atol=EXACT_M)

    cloud = read_points(radar, 0)
    x, y, z, _ = TARGETS[0]
    strongest = cloud.points_m[cloud.amplitude.argmax()]
    np.testing.assert_allclose(strongest, [-x, y, z], rtol=0, atol=EXACT_M)
    assert cloud.amplitude.max() == 1.0
    from_depth = read_depth_map(radar, 0).points_m()
    order = np.lexsort(cloud.points_m[:, :2].T), np.lexsort(from_depth[:, :2].T)
    np.testing.assert_allclose(
        cloud.points_m[order[0]], from_depth[order[1]], rtol=0, atol=HALF_MM_M
    )


def test_a_radar_folder_is_named_by_a_string_too(radar):
    for read, name in (
        (read_depth_map, "depth_m"),
        (read_max_projection, "amplitude"),
        (read_amplitude_volume, "amplitude"),
        (read_points, "points_m"),
    ):
        expected = getattr(read(radar, 0), name)
        assert np.array_equal(getattr(read(str(radar), 0), name), expected, equal_nan=True)


def test_older_depth_maps_are_rotated_in_memory(radar, scene):
    expected = read_depth_map(radar, 0)
    path = radar / "depth" / "000000.png"
    path.write_bytes(made.png(made.png_pixels(path.read_bytes())[::-1]))
    assert not np.array_equal(read_depth_map(radar, 0).depth_m, expected.depth_m, equal_nan=True)

    def older(entry):
        entry["depth"] = {"transform": np.eye(4).tolist()}

    before = path.read_bytes()
    change_entry(radar, older)
    turned = read_depth_map(radar, 0)
    assert np.array_equal(turned.depth_m, expected.depth_m, equal_nan=True)
    assert np.array_equal(turned.amplitude, expected.amplitude)  # maxproj is not turned
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("threshold", "expected"), [(14, 14.0), (-14, 14.0), (-0.5, 0.5), (0, 15.0), (None, 15.0)]
)
def test_threshold_of_a_depth_map(radar, threshold, expected):
    amplitude = {"amplitude_filter_kernel_size": 1, "amplitude_filter_threshold_dB": threshold}
    change_entry(radar, lambda entry: entry.update(amplitude=amplitude))
    assert read_depth_map(radar, 0).dynamic_range_db == expected


@pytest.mark.parametrize("keys", [("max_amplitude",), ("min_amplitude", "max_amplitude")])
@pytest.mark.parametrize("value", [1e39, 1.7e308])
def test_amplitudes_that_float32_cannot_hold(radar, keys, value):
    change_entry(radar, lambda entry: entry["volume"].update(dict.fromkeys(keys, value)))
    assert "float32" in refused(radar, "volume")


@pytest.mark.parametrize("where", ["depth box", "depth box in 3-D", "intrinsics", "its inverse"])
def test_pixels_are_placed_by_what_there_is(radar, where):
    expected = read_depth_map(radar, 0)

    def change(entry):
        box = {k: v for k, v in entry.pop("volume").items() if "amp" not in k and "abs" not in k}
        if where == "depth box":
            entry["depth"] = {k: v[:2] for k, v in box.items()}
        elif where == "depth box in 3-D":
            entry["depth"] = box
        elif where == "its inverse":
            entry["depth"]["intrinsics"] = np.linalg.inv(entry["depth"]["intrinsics"]).tolist()

    change_entry(radar, change)
    depth = read_depth_map(radar, 0)
    assert np.array_equal(depth.depth_m, expected.depth_m, equal_nan=True)
    np.testing.assert_allclose(depth.x_m, expected.x_m, rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(depth.y_m, expected.y_m, rtol=0, atol=EXACT_M)


@pytest.mark.parametrize("other", [None, (5, 7)])
def test_amplitude_of_a_depth_map_without_maxproj(radar, other):
    path = radar / "maxproj" / "000000.png"
    if other is None:
        path.unlink()
    else:
        path.write_bytes(made.png(np.ones(other, int)))
    depth = read_depth_map(radar, 0)
    assert np.array_equal(depth.amplitude, depth.mask.astype(np.float32))


# ---- what is missing or contradicts itself


@pytest.mark.parametrize("product", READERS)
def test_a_missing_product_lists_the_frames_that_have_it(radar, product, scene):
    made.write_products(radar, 3, scene)
    message = refused(radar, product, 1)
    assert f"{product}/000001." in message
    assert "0, 3" in message
    for path in (radar / product).iterdir():
        path.unlink()
    assert "none of any frame" in refused(radar, product)
    (radar / product).rmdir()
    assert "none of any frame" in refused(radar, product)


@pytest.mark.parametrize("product", ["depth", "maxproj", "volume"])
def test_without_calibration_pixels_have_no_position(radar, product):
    change_entry(radar, dict.clear)
    assert "bb_min" in refused(radar, product)
    (radar / "calibration.json").write_text("{}")
    assert "'000000'" in refused(radar, product)
    (radar / "calibration.json").unlink()
    assert "calibration.json" in refused(radar, product)
    read_points(radar, 0)  # carries its own positions


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("bb_min", [0, 0], "a list of 3"),
        ("bb_min", "0", 'got "0"'),
        ("bb_min", [0, 0, True], "got true"),
        ("bb_min", [0, 0, float("nan")], "finite"),
        ("bb_max", [-1, -1, -1], "bb_min below bb_max"),
        ("grid_size", [31, 21, 9.5], "whole numbers"),
        ("grid_size", [31, 0, 9], "whole numbers"),
        ("grid_size", [1, 21, 9], "one point"),
        ("grid_size", [31, 21, 10], "31 x 21 x 10"),
        ("grid_size", [21, 31, 9], "order y, x, z"),
        ("min_amplitude", 1e6, "min_amplitude <= max_amplitude"),
        ("max_amplitude", None, "max_amplitude"),
        ("max_amplitude", 10**400, "finite"),
        ("max_amplitude", {}, "got { }"),
    ],
)
def test_invalid_entries(radar, key, value, found):
    change_entry(radar, lambda entry: entry["volume"].update({key: value}))
    assert found in refused(radar, "volume")


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(4).tolist(),
        np.diag([1, -1, 1000, 1]) + np.eye(4)[::-1],
        np.zeros((4, 4)),
        np.diag([100, 100, 1000, 1]),
        [[1, 2]] * 4,
        [1] * 5,
        1e308 * (np.diag([1, -1, 1e-305, 0]) + np.eye(4)[::-1]),
        1e-200 * np.diag([1, -1, 1000, 1]),
        np.diag([1e-300, -1e-300, 1000, 1]) + 1e308 * np.eye(4)[3] * np.eye(4)[:, :1],
        "no matrix",
    ],
)
def test_matrices_that_place_no_pixels(radar, matrix):
    def change(entry):
        del entry["volume"]
        entry["depth"]["intrinsics"] = np.asarray(matrix).tolist()

    change_entry(radar, change)
    assert "intrinsics" in refused(radar, "depth")


def test_two_grids_of_one_frame(radar, scene):
    box = {"bb_min": [-0.1, -0.08], "bb_max": [0.14, 0.05], "grid_size": [31, 21]}
    rounded = box | {"bb_min": [float(np.float32(v)) for v in box["bb_min"]]}
    change_entry(radar, lambda entry: entry["depth"].update(rounded))
    read_depth_map(radar, 0)
    change_entry(radar, lambda entry: entry["depth"].update(bb_max=[0.14, 0.06]))
    for product in ("depth", "maxproj"):
        assert "0.05 m and 31" in refused(radar, product)


def test_image_of_another_size_than_the_grid(radar):
    (radar / "depth" / "000000.png").write_bytes(made.png(np.ones((31, 21), int)))
    assert "31 rows of 21" in refused(radar, "depth")


def test_calibration_file_as_records(radar, scene):
    (radar / "calibration.json").write_text(
        json.dumps(
            json.loads((radar / "calibration.json").read_text())
            | {"frequency_low_ghz": 72.0, "frequency_points": 2, "000001": {}, "more": [1]}
        )
    )
    content = read_calibration_file(radar / "calibration.json")
    assert (content.frequency_low_ghz, content.frequency_high_ghz) == (72.0, None)
    assert (content.frequency_points, sorted(content.frames)) == (2, [0, 1])
    box = content.frames[0].volume.box
    assert box.counts == (31, 21, 9)
    np.testing.assert_array_equal(box.axis_m(1), scene.y_m)
    assert content.frames[1].volume is None
    assert read_frame_entry(radar / "calibration.json", 2) is None


# ---- hostile files


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "empty"),
        (b"GIF89a" * 9, "something else"),
        (made.png(np.ones((3, 3), int), bits=8), "8 bits"),
        (made.png(np.ones((3, 3), int))[:-20], "cut short|Truncated"),
        (made.png(np.ones((3, 3), int))[:-16] + b"\0" * 16, "broken PNG"),
        (made.png_of_chunks([(b"IEND", b"")]), "cut short"),
        (made.png_of_chunks([(b"IHDR", b"\0" * 5), (b"IEND", b"")]), "something else"),
    ],
)
def test_other_images(radar, content, found):
    (radar / "depth" / "000000.png").write_bytes(content)
    assert re.search(found, refused(radar, "depth"))


def bomb(width: int, height: int, kind: int = 0, size: int = 10**8) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 16, kind, 0, 0, 0)
    data = zlib.compress(bytes(size), 9)
    return made.png_of_chunks([(b"IHDR", header), (b"IDAT", data), (b"IEND", b"")])


@pytest.mark.parametrize(
    ("width", "height", "found"),
    [
        (2**31 - 1, 2**31 - 1, "pixels"),
        (0, 5, "pixels"),
        (60_000, 60_000, "pixels"),
        (9, 9, "9 rows of 9"),
    ],
)
def test_images_that_would_grow_are_not_decompressed(radar, width, height, found):
    (radar / "depth" / "000000.png").write_bytes(bomb(width, height))
    tracemalloc.start()
    message = refused(radar, "depth")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found in message
    assert peak < 5e6, f"{peak:.3g} bytes for a file of 0.1 MB"


@pytest.mark.parametrize("size", [1000, 10**8])
def test_other_chunks_do_not_matter_and_do_not_grow(radar, size):
    path = radar / "depth" / "000000.png"
    plain, expected = made.png_pixels(path.read_bytes()), read_depth_map(radar, 0)
    header = struct.pack(">IIBBBBB", *plain.shape[::-1], 16, 0, 0, 0, 0)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in plain)
    packed = zlib.compress(bytes(size), 9)
    chunks = [(b"IHDR", header), (b"zTXt", b"Comment\0\0" + packed), (b"tEXt", b"a\0b")]
    chunks += [(b"iCCP", b"profile\0\0" + packed), (b"abCd", b"private")]
    chunks += [(b"IDAT", zlib.compress(rows)), (b"iTXt", b"b\0\1\0\0\0" + packed), (b"IEND", b"")]
    path.write_bytes(made.png_of_chunks(chunks))
    tracemalloc.start()
    if size == 1000:
        assert (
            read_depth_map(radar, 0).depth_m[expected.mask] == expected.depth_m[expected.mask]
        ).all()
    else:
        assert "too large" in refused(radar, "depth")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5e6, f"{peak:.3g} bytes for a file of 0.1 MB"


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        (b"ply\n", b"", "something else"),
        (b"end_header\n", b"end_footer\n", "header that ends"),
        (b"element vertex 5859", b"element vertex 99999999999", "at most"),
        (b"element vertex 5859", b"element vertex 5860", "too short"),
        (b"element vertex 5859", b"element vertex 5858", "5858"),
        (b"element vertex 5859", b"element vertex -1", "vertex"),
        (b"element vertex 5859", b"element face 5859", "vertex"),
        (b"double x", b"double w", "'x'"),
        (b"uchar red", b"short red", "8-bit|too short"),
        (b"property double z", b"property list uchar int z", "list"),
        (b"double y", b"double x", "twice"),
        (b"binary_little_endian", b"binary_middle_endian", "middle"),
        (b"comment made by a test", b"obj_info \xff\xfe", None),
        (b"format", b"comment " + b"x" * 70_000 + b"\nformat", "header that ends"),
    ],
)
def test_other_point_files(radar, old, new, found):
    path = radar / "volume" / "000000.ply"
    content = path.read_bytes()
    assert content.count(old) >= 1
    path.write_bytes(content.replace(old, new, 1))
    if found is None:
        read_amplitude_volume(radar, 0)
    else:
        assert re.search(found, refused(radar, "volume"))


@pytest.mark.parametrize("word", ["x", "nan", "inf", "1e999", "1 2", "", "0x10"])
def test_text_that_is_no_number(radar, word):
    path = radar / "xyz" / "000000.ply"
    points, colours = [(0.0, 0.0, 0.3)] * 3, [(0, 255, 0)] * 3
    content = made.ply(points, colours, "ascii").replace(b"0.3 0", f"{word} 0".encode(), 1)
    path.write_bytes(content)
    refused(radar, "xyz")


def test_points_without_colour_and_no_points(radar):
    path = radar / "xyz" / "000000.ply"
    path.write_bytes(path.read_bytes().replace(b"uchar green", b"uchar verde"))
    assert "green" in refused(radar, "xyz")
    path.write_bytes(made.ply([], [], "binary_little_endian"))
    assert read_points(radar, 0).points_m.shape == (0, 3)


@posix_only
def test_a_product_that_is_no_file(radar):
    (radar / "xyz" / "000000.ply").unlink()
    os.mkfifo(radar / "xyz" / "000000.ply")
    assert "regular file" in refused(radar, "xyz")
    (radar / "depth" / "000000.png").unlink()
    (radar / "depth" / "000000.png").mkdir()
    assert "folder" in refused(radar, "depth")


def test_limits_hold_before_anything_is_read(radar, monkeypatch):
    monkeypatch.setattr(png16, "MAX_IMAGE_PIXELS", 31 * 21 - 1)
    assert "at most 650 pixels" in refused(radar, "depth")
    monkeypatch.setattr(ply_points, "MAX_PLY_TEXT_BYTES", 10)
    (radar / "xyz" / "000000.ply").write_bytes(made.ply([(0, 0, 1)], [(0, 0, 0)], "ascii"))
    assert "at most 10 bytes" in refused(radar, "xyz")


# ---- written


def antenna_volume(scene: made.RadarScene, scale: float) -> clradar.Volume:
    """Return a scene of radar space as an image in the antenna frame, with a phase."""
    amplitude = scene.amplitude[::-1].transpose(2, 1, 0) / scale
    z = np.arange(len(scene.z_m))[:, None, None]
    grid = clradar.VoxelGrid.from_extent(
        (-scene.x_m[-1], -scene.x_m[0]),
        (scene.y_m[0], scene.y_m[-1]),
        (scene.z_m[0], scene.z_m[-1]),
        [float(np.ptp(a)) / (len(a) - 1) for a in (scene.x_m, scene.y_m, scene.z_m)],
    )
    return clradar.Volume(amplitude * np.exp(1j * z), grid)


@pytest.fixture
def empty_radar(tmp_path: Path) -> Path:
    folder = tmp_path / "written" / f"radar_72.0_82.0_{N_FREQ}"
    folder.mkdir(parents=True)
    (folder / "calibration.json").write_text(
        json.dumps({"frequency_points": N_FREQ, "kept": 1, "000007": {"depth": {}}})
    )
    return folder


FLOAT32 = 3e-7
"""Relative rounding of abs, a product and a scaling in float32."""


def test_written_products_are_those_of_the_independent_writer(radar, empty_radar, scene):
    volume = antenna_volume(scene, N_FREQ)
    depth_png, maxproj_png, volume_ply, xyz_ply = write_products(empty_radar, 0, volume)
    assert depth_png == empty_radar / "depth" / "000000.png"

    def of(folder: str) -> bytes:
        (path,) = (radar / folder).iterdir()
        return path.read_bytes()

    # Rounding in float32 may carry an amplitude over to the next whole number.
    theirs = made.png_pixels(of("maxproj")).astype(int)
    assert np.abs(made.png_pixels(maxproj_png.read_bytes()) - theirs).max() <= 1
    # The independent writer takes the voxel, ours the parabola through its neighbours: half a step.
    mine = made.png_pixels(depth_png.read_bytes()).astype(int)
    theirs = made.png_pixels(of("depth")).astype(int)
    assert np.array_equal(mine > 0, theirs > 0)
    assert np.abs(mine - theirs).max() <= 1e3 * np.diff(scene.z_m)[0] / 2 + 0.5 + 1e-9

    for mine_ply, folder in ((volume_ply, "volume"), (xyz_ply, "xyz")):
        points, colours = made.ply_points(mine_ply.read_bytes())
        their_points, their_colours = made.ply_points(of(folder))
        if folder == "xyz":  # whose order nothing states
            order, theirs = (np.lexsort(np.round(p[:, :2], 9).T) for p in (points, their_points))
            points, colours = points[order], colours[order]
            their_points, their_colours = their_points[theirs], their_colours[theirs]
        np.testing.assert_allclose(points[:, :2], their_points[:, :2], rtol=0, atol=EXACT_M)
        assert np.abs(colours - their_colours).max() <= 1
        step = EXACT_M if folder == "volume" else np.diff(scene.z_m)[0] / 2 + EXACT_M
        np.testing.assert_allclose(points[:, 2], their_points[:, 2], rtol=0, atol=step)

    content = json.loads((empty_radar / "calibration.json").read_text())
    theirs = json.loads((radar / "calibration.json").read_text())["000000"]
    mine = content["000000"]
    for part, keys in theirs.items():
        for key, value in keys.items():
            np.testing.assert_allclose(mine[part][key], value, rtol=FLOAT32, atol=EXACT_M)
    assert (content["kept"], content["000007"]) == (1, {"depth": {}})


def test_written_products_read_back(empty_radar, scene):
    volume = antenna_volume(scene, N_FREQ)
    write_products(str(empty_radar), 0, volume, dynamic_range_db=9.0)
    mine, read = volume.depth_map(9.0), read_depth_map(empty_radar, 0)
    np.testing.assert_allclose(read.depth_m, mine.depth_m, rtol=0, atol=HALF_MM_M)
    np.testing.assert_allclose(read.x_m, mine.x_m, rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(read.y_m, mine.y_m, rtol=0, atol=EXACT_M)
    assert read.dynamic_range_db == 9.0
    image = read_max_projection(empty_radar, 0)
    cut = volume.max_projection() * N_FREQ - image.amplitude
    assert cut.min() >= -1e-3
    assert cut.max() < 1 + 1e-3
    amplitude = read_amplitude_volume(empty_radar, 0)
    expected = np.abs(volume.data) * N_FREQ
    half_step = 0.5 * np.ptp(expected) / 255 * (1 + 1e-5)
    np.testing.assert_allclose(amplitude.amplitude, expected, rtol=0, atol=half_step)
    assert amplitude.grid.same_voxels(volume.grid, EXACT_M)
    cloud = read_points(empty_radar, 0)
    order = [np.lexsort(p[:, :2].T) for p in (cloud.points_m, mine.points_m())]
    np.testing.assert_allclose(
        cloud.points_m[order[0]], mine.points_m()[order[1]], rtol=0, atol=EXACT_M
    )


def test_one_voxel_along_an_axis(empty_radar):
    grid = clradar.VoxelGrid.from_extent((0.01, 0.01), (-0.02, 0.02), (0.3, 0.3), 0.01)
    data = np.arange(1.0, 6.0).reshape(1, 5, 1)
    write_products(empty_radar, 2, clradar.Volume(data, grid))
    depth = read_depth_map(empty_radar, 2)
    np.testing.assert_allclose(depth.x_m, [0.01], rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(depth.y_m, grid.y_m, rtol=0, atol=EXACT_M)
    assert read_amplitude_volume(empty_radar, 2).amplitude.argmax() == 4


@pytest.mark.parametrize(
    ("scale", "gain", "found"),
    [(1e9, 1.0, "gain"), (1e-3, 1.0, "65535"), (1e9, 1e9, None), (np.inf, 1.0, "zero everywhere")],
)
def test_amplitudes_that_16_bits_cannot_hold(empty_radar, scene, scale, gain, found):
    volume = antenna_volume(scene, scale)
    before = (empty_radar / "calibration.json").read_bytes()
    if found is None:
        write_products(empty_radar, 0, volume, gain=gain)
        return
    with pytest.raises(ModelError, match=found):
        write_products(empty_radar, 0, volume, gain=gain)
    assert (empty_radar / "calibration.json").read_bytes() == before
    assert sorted(p.name for p in empty_radar.iterdir()) == ["calibration.json"]


def test_products_are_kept_without_force(radar, scene):
    made.put_entry(radar, 0, json.loads((radar / "calibration.json").read_text())["000000"])
    content = json.loads((radar / "calibration.json").read_text()) | {"frequency_points": 2}
    (radar / "calibration.json").write_text(json.dumps(content))
    before = {path: path.read_bytes() for path in radar.rglob("*.p*")}
    with pytest.raises(OutputError, match="exists already"):
        write_products(radar, 0, antenna_volume(scene, N_FREQ))
    assert before == {path: path.read_bytes() for path in radar.rglob("*.p*")}
    write_products(radar, 0, antenna_volume(scene, N_FREQ), force=True)
    assert before != {path: path.read_bytes() for path in radar.rglob("*.p*")}

"""What the view draws, in the radar's view, and means by a click; samples of data sets in it."""

import numpy as np
import pytest
from dataset_plans import plan_of

import clradar
from calibration import CornerReflector, response
from clradar.dataset import Sample, recipe
from clradar.dataset.folder import Manifest, shard_name, write_manifest
from clradar.dataset.sample import SamplePlan, read_recipe
from clradar.dataset.shards import Aside, new_shard
from clradar.errors import MeasurementError, ModelError
from clradar.view import sources
from clradar.view.drawn import SCALES, Drawn, Flat, clicked_m, colours_on, voxels_of
from clradar.view.pictures import image_pictures, overview_picture, pair_curves, slice_pictures
from clradar.view.sources import SampleFrames, open_source
from clradar.view.wish import grid_mm

GRID = clradar.VoxelGrid([-0.01, 0.0, 0.30], [0.01, 0.01, 0.01], (3, 2, 4))

STRONGEST = colours_on("amplitude", np.zeros(1), -20.0, 0.0)[0]


def drawn_of(*voxels, grid=GRID):
    """A volume with these voxels (x, y, z, amplitude), 0 elsewhere."""
    data = np.zeros(grid.shape, np.complex64)
    for x, y, z, amplitude in voxels:
        data[z, y, x] = amplitude
    return Drawn.of(clradar.Volume(data, grid), 20.0)


def lit(picture, colour=STRONGEST):
    """Where on the axes, millimetres, the middle of all pixels of a colour is; [] without any."""
    left, top, right, bottom = picture.box
    rows, columns = np.nonzero((picture.pixels[top:bottom, left:right] == colour).all(axis=2))
    if not len(rows):
        return []
    at_m = at_pixel(picture, left + columns.mean() + 0.5, top + rows.mean() + 0.5)
    return [(1e3 * at_m[0], 1e3 * at_m[1])]


def at_pixel(picture, column, row):
    rows, columns = picture.pixels.shape[:2]
    return picture.values_m(column / columns, row / rows)


def near(*values):
    return pytest.approx(values, abs=0.2)


def test_x_is_to_the_left_and_y_upwards():
    drawn = drawn_of((2, 1, 1, 1.0))
    picture = image_pictures(drawn, None, drawn, None)["projection"]
    assert lit(picture) == [near(10, 10)]
    assert (picture.across.first, picture.across.last) == (15.0, -15.0)
    assert (picture.up.first, picture.up.last) == (-5.0, 15.0)
    left, top, right, bottom = picture.box
    assert (bottom - top) / (right - left) == pytest.approx(2 / 3, rel=0.03)  # equal scales
    assert at_pixel(picture, left - 3, top + 3) is None


def test_slices_go_through_the_place():
    drawn = drawn_of((2, 1, 3, 1.0), (0, 0, 0, 0.5))
    assert drawn.strongest_m() == pytest.approx((0.01, 0.01, 0.33))
    slices = slice_pictures(drawn, (0.012, 0.008, 0.331))
    for name, at in (("xy", (10, 10)), ("xz", (10, 330)), ("zy", (330, 10))):
        assert lit(slices[name]) == [near(*at)], name
    # A place without the strongest voxel: its slices are dark relative to the whole volume.
    assert not any(map(lit, slice_pictures(drawn, (-0.01, 0.0, 0.30)).values()))


def test_a_click_on_a_picture_means_what_is_drawn_there():
    drawn = drawn_of((2, 1, 3, 1.0), (0, 0, 1, 0.9))
    at_m = (0.01, 0.01, 0.33)
    pictures = slice_pictures(drawn, at_m)
    pictures["projection"] = image_pictures(drawn, None, drawn, None)["projection"]
    for name, picture in pictures.items():
        (place,) = lit(picture)
        assert drawn.pointed_m(at_m, name, 1e-3 * place[0], 1e-3 * place[1]) == pytest.approx(at_m)
    assert drawn.pointed_m(at_m, "projection", -0.012, -0.004) == pytest.approx((-0.01, 0, 0.31))
    assert drawn.level_db((-0.01, 0, 0.31)) == pytest.approx(20 * np.log10(0.9))
    assert np.isnan(drawn.depth_m((0.0, 0.0, 0.3)))


def test_a_click_takes_the_point_that_its_ray_meets_first():
    points_m = np.array([[0.0, 0.0, 0.32], [0.0, 0.001, 0.30], [0.03, 0.0, 0.25]], np.float32)
    eye = np.array([0.0, 0.0, -0.2])
    ahead = np.array([0.0, 0.0, 5.0])
    assert clicked_m(points_m, eye, ahead, 2e-3) == pytest.approx((0.0, 0.001, 0.30))
    aside = points_m[2] - eye
    assert clicked_m(points_m, eye, aside, 2e-3) == pytest.approx((0.03, 0.0, 0.25))
    assert clicked_m(points_m, eye, np.array([0.0, 1.0, 0.0]), 2e-3) is None
    assert clicked_m(points_m, eye, -ahead, 2e-3) is None  # behind the eye


def test_the_difference_is_brown_where_the_simulation_is_farther():
    first, second = (drawn_of((0, 0, z, 1.0), (1, 0, 1, 1.0)) for z in (1, 2))
    picture = image_pictures(first, second, first, None)["difference"]
    scale = SCALES["difference"](np.arange(256), bytes=True)[:, :3].astype(int)
    assert scale[255, 0] > scale[255, 2] + 100
    assert scale[128].min() > 250
    assert lit(picture, scale[255]) == [near(-10, 0)]
    assert lit(picture, scale[128]) == [near(0, 0)]
    other = drawn_of((0, 0, 0, 1.0), grid=clradar.VoxelGrid([0, 0, 0.3], [0.01] * 3, (3, 3, 4)))
    assert "difference" not in image_pictures(first, other, first, None)


@pytest.mark.parametrize("known", ["projection", "depth"])
def test_of_a_data_set_only_what_is_stored_is_drawn(known):
    there = known == "depth"
    depth_m, axis_m = np.full((2, 2), 0.3 if there else np.nan), [0.0, 0.01]
    image = clradar.DepthMap(depth_m, np.ones((2, 2)), axis_m, axis_m)
    drawn = Drawn.of(Flat(image, (known,)), 20.0, voxels=True)
    assert list(image_pictures(drawn, None, drawn, None)) == [known]
    assert slice_pictures(drawn, (0, 0, 0.3)) == {}
    assert len(drawn.points_m) == (4 if there else 0)
    assert drawn.pointed_m((0, 0, 0.4), "projection", 0.01, 0.0)[2] == (0.3 if there else 0.4)


def test_channel_data_of_a_pair_peak_at_its_range():
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 64)
    data = response(CornerReflector((0.0, 0.0, 0.3)), array, waveform)
    data[5, 7] *= 1e-3
    capture = clradar.Capture(data, array, waveform)
    overview = overview_picture(capture, 93, 93)
    left, top, right, bottom = overview.box
    dark = overview.pixels[top:bottom, left:right].astype(int).sum(axis=2)
    row, column = np.unravel_index(dark.argmin(), dark.shape)
    at = at_pixel(overview, left + column + 1, top + row + 1)
    assert at == pytest.approx((7, 5), abs=0.6)  # Tx upwards
    curves = pair_curves(capture, 5, 7)
    assert list(curves) == ["magnitude (dB)", "phase (turns)", "range profile (dB)"]
    name, place_mm, level_db = curves["range profile (dB)"]
    legs_m = [np.linalg.norm(at_m - [0, 0, 0.3]) for at_m in (array.tx_m[5], array.rx_m[7])]
    assert name == "half the path (mm)"
    assert place_mm[level_db.argmax()] == pytest.approx(500 * sum(legs_m), abs=10)


def test_points_and_voxels_are_those_within_the_range_coloured_by_level():
    drawn = drawn_of((0, 0, 1, 1.0), (2, 1, 2, 0.5), (1, 1, 1, 0.01))
    np.testing.assert_allclose(drawn.points_m, [[-0.01, 0, 0.31], [0.01, 0.01, 0.32]], atol=1e-7)
    expected = colours_on("amplitude", np.array([0.0, 20 * np.log10(0.5)]), -20.0, 0.0)
    np.testing.assert_array_equal(drawn.colours, expected)
    assert not np.array_equal(expected[0], expected[1])
    volume = drawn_of((0, 0, 0, 1.0), (1, 0, 0, 0.5), (2, 0, 3, 0.2), (1, 1, 1, 0.05)).volume
    at_m = [[-0.01, 0, 0.30], [0, 0, 0.30], [0.01, 0, 0.33]]
    np.testing.assert_allclose(voxels_of(volume, 20.0)[0], at_m, atol=1e-7)
    np.testing.assert_allclose(voxels_of(volume, 20.0, most=2)[0], at_m[:2], atol=1e-7)


def test_grids_that_cannot_be_viewed():
    for x_mm, words in (((10, -10), "first <= last"), ((-900, 900), "at most")):
        with pytest.raises(ModelError, match=words):
            grid_mm(x_mm, (-100, 100), (260, 340), 0.1)


DEPTH_M = 0.31


def arrays_of(made, products):
    """Products of a sample that is bright in one pixel, by its number."""
    ny, nx = read_recipe(made).plan.image.grid.shape[1:]
    depth = np.full((ny, nx), np.nan, np.float32)
    depth[1, 2] = DEPTH_M
    projection = np.full((ny, nx), 0.01, np.float32)
    projection[1, 2] = 1.0 + made["sample"]
    found = {
        "capture": np.full((12, 12, 16), 1.0 + made["sample"], np.complex64),
        "max_projection": projection,
        "depth_map": depth,
        "joints": np.full((25, 3), 0.3),
        "mesh_vertices": np.eye(3, dtype=np.float32),
        "mesh_faces": np.array([[0, 1, 2]], np.int32),
        "mesh_part": np.zeros(1, np.uint8),
    }
    return {name: array for name, array in found.items() if name.partition("_")[0] in products}


def data_set(folder, *products, count=12, size=5):
    """Write a data set in shards; of sample 6 it is told why there is none."""
    plan = plan_of(
        samples=count,
        output={"shard_size": size, "products": ["max_projection", "depth_map", *products]},
    )
    kept = {"max", "depth", *products}
    (folder / "shards").mkdir(parents=True)
    aside = {6: Aside(sample=6, reason="poisoned", attempts=2)} if count > 6 else {}
    write_manifest(folder, Manifest(plan=plan, set_aside=(*aside.values(),)))
    for shard in range(plan.n_shards):
        with new_shard(folder / shard_name(shard), plan) as writer:
            for sample in plan.shard_samples(shard):
                if sample not in aside:
                    made = recipe(plan, sample)
                    writer.add(Sample(made, arrays_of(made, kept)), {})
    return folder


@pytest.fixture(scope="module")
def letters(tmp_path_factory):
    return data_set(tmp_path_factory.mktemp("view") / "letters", "joints", "mesh")


def test_projection_and_depth_map_are_shown_without_a_volume(letters):
    source = SampleFrames(letters)
    flat = source.read(3)
    assert isinstance(flat, Flat)
    assert flat.known == ("projection", "depth")
    drawn = Drawn.of(flat, 15.0)
    assert np.flatnonzero(drawn.image.mask).tolist() == [1 * len(flat.image.x_m) + 2]
    assert drawn.image.depth_m[1, 2] == np.float32(DEPTH_M)
    assert drawn.image.amplitude.max() == 4.0
    assert drawn.volume is None  # none is made up, and points are as small as a pixel
    assert drawn.size_m == pytest.approx(np.diff(flat.image.x_m).min())


def test_captures_are_there_to_be_imaged(tmp_path):
    folder = data_set(tmp_path / "captures", "capture", count=2, size=1)
    capture = SampleFrames(folder).read(1)
    assert isinstance(capture, clradar.Capture)
    assert capture.data[0, 0, 0] == 2.0


def test_the_truth_is_that_of_the_recipe(letters):
    source = SampleFrames(letters)
    truth = source.truth(4)
    made = SamplePlan(sources.read_manifest(letters).plan, 4)
    assert (truth.vertices_m.shape, truth.joints_m.shape) == ((3, 3), (25, 3))
    assert truth.lines[0] == f"pose {made.pose.name}, {made.plan.hands.handedness} hand"
    assert f"palm {made.plan.alpha.of_parts['palm']:.2f}" in truth.lines[-1]
    plan = plan_of(alpha=None, simulation={"estimator": "physical", "samples_per_mm2": None})
    assert "material: palm palm, thumb palm" in sources._recipe_lines(SamplePlan(plan, 0))[-1]


def test_a_data_set_that_is_written_is_followed(tmp_path):
    folder = data_set(tmp_path / "growing", count=3, size=1)
    third = folder / "shards/shard-00002.h5"
    content = third.read_bytes()
    third.unlink()
    source = open_source(folder, watch=True)
    assert not source.look()
    third.write_bytes(content)
    assert source.look()
    assert source.frames() == (0, 1, 2)


def test_data_sets_that_cannot_be_viewed(tmp_path):
    empty = data_set(tmp_path / "empty", count=1, size=1)
    (empty / "shards/shard-00000.h5").unlink()
    with pytest.raises(MeasurementError, match="at least one sample, got none"):
        open_source(empty)
    folder = data_set(tmp_path / "damaged", count=2, size=1)
    (folder / "shards/shard-00001.h5").write_bytes(b"no HDF5")
    source = open_source(folder)
    with pytest.raises(MeasurementError, match=r"shard-00001\.h5"):
        source.read(1)
    assert source.read(0).image.amplitude.max() == 1.0
    (folder / "manifest.json").write_text("{}")
    with pytest.raises(MeasurementError, match=r"manifest\.json"):
        open_source(folder)

"""Data sets in the live view: an index of thousands, one sample read at a time, its truth."""

import numpy as np
import pytest
from dataset_plans import plan_of

import clradar
from clradar.dataset import Sample, recipe
from clradar.dataset.folder import Manifest, shard_name, write_manifest
from clradar.dataset.plan.recipe import SamplePlan, read_recipe
from clradar.dataset.shards import new_shard
from clradar.errors import MeasurementError
from clradar.jobs.outcome import Aside
from clradar.view import samples
from clradar.view.drawn import Drawn, Flat
from clradar.view.samples import KEPT_SAMPLES, SampleFrames
from clradar.view.sources import open_source

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
    aside = {6: Aside(6, "poisoned", 2)} if count > 6 else {}
    write_manifest(folder, Manifest(plan, {}, aside))
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


def test_samples_are_read_when_they_are_looked_at(letters, monkeypatch):
    read: list[tuple[str, int]] = []
    read_sample = samples.read_sample

    def counted(path, sample, plan):
        read.append((path.name, sample))
        return read_sample(path, sample, plan)

    monkeypatch.setattr(samples, "read_sample", counted)
    source = open_source(letters)
    assert source.frames() == (0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11)
    source.choose(pose="B")
    source.choose()
    assert read == []
    for sample in (7, 7, 11):
        assert source.read(sample).image.amplitude.max() == 1 + sample
        source.truth(sample)
    assert read == [("shard-00001.h5", 7), ("shard-00002.h5", 11)]
    for sample in (*range(KEPT_SAMPLES - 2), 7):
        source.read(sample)
    assert len(read) == KEPT_SAMPLES  # two and six others: 7 was kept
    source.read(9)
    source.read(11)
    assert len(read) == KEPT_SAMPLES + 2  # 11 had to go for 9


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
    assert drawn.cloud.size_m == pytest.approx(np.diff(flat.image.x_m).min())


def test_captures_are_there_to_be_imaged(tmp_path):
    folder = data_set(tmp_path / "captures", "capture", count=2, size=1)
    capture = SampleFrames(folder).read(1)
    assert isinstance(capture, clradar.Capture)
    assert capture.data[0, 0, 0] == 2.0


def test_the_truth_is_that_of_the_recipe(letters):
    source = SampleFrames(letters)
    truth = source.truth(4)
    made = SamplePlan(samples.read_manifest(letters).plan, 4)
    assert truth.vertices_m.shape == (3, 3)
    assert truth.joints_m.shape == (25, 3)
    assert truth.lines[0] == f"pose {made.pose.name}, {made.plan.hands.handedness} hand"
    assert f"palm {made.plan.alpha.of_parts['palm']:.2f}" in truth.lines[-1]


def test_samples_are_chosen_by_pose_and_hand(letters):
    source = SampleFrames(letters)
    assert source.poses == ("A", "B", "F")
    truths = {frame: source.truth(frame).lines[0] for frame in source.frames()}
    for hand in ("right", "left"):
        source.choose("F", hand)
        expected = tuple(f for f, line in truths.items() if line == f"pose F, {hand} hand")
        assert source.frames() == expected
    assert sum("pose F" in line for line in truths.values()) >= 3


def test_a_data_set_that_is_written_is_followed(tmp_path):
    folder = data_set(tmp_path / "growing", count=3, size=1)
    third = folder / "shards/shard-00002.h5"
    content = third.read_bytes()
    third.unlink()
    source = open_source(folder, watch=True)
    source.choose(pose="F")
    assert source.frames() == ()
    assert not source.look()
    third.write_bytes(content)
    assert source.look()
    assert source.frames() == (2,)  # the third pose is the chosen one
    source.choose()
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

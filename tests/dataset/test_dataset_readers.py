"""Data sets read by xarray and PyTorch."""

import json
import pickle
import shutil
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from dataset_plans import PLAN

import clradar
from clradar.dataset import TorchDataset, open_dataset, recipe
from clradar.dataset.shards import labels_of, read_sample
from clradar.errors import ClradarError, MeasurementError, ModelError
from clradar.hand import JOINT_NAMES


def test_xarray_has_the_numbers_axes_units_and_labels(made):
    view = clradar.open_dataset(made)
    assert view.sizes["sample"] == 5
    assert view.sample.values.tolist() == list(range(5))
    assert view.pose.values.tolist() == ["A", "B", "F", "A", "B"]
    for sample in (0, 3):
        shard = made / "shards" / f"shard-{sample // 2:05d}.h5"
        again = read_sample(shard, sample, PLAN)[0].arrays
        one = view.sel(sample=sample)
        for name in ("capture", "volume", "max_projection", "depth_map", "joints"):
            np.testing.assert_array_equal(one[name].values, again[name])
        first, end = int(one.mesh_vertices_first), int(one.mesh_vertices_end)
        np.testing.assert_array_equal(view.mesh_vertices[first:end].values, again["mesh_vertices"])
        # Counted from 0 within the sample, as the docs have it.
        faces = view.mesh_faces[int(one.mesh_faces_first) : int(one.mesh_faces_end)].values
        assert (faces.min(), faces.max()) == (0, end - first - 1)
        assert json.loads(one.recipe.values.item()) == recipe(PLAN, sample)
        assert one.alpha.sel(part="palm") == recipe(PLAN, sample)["alpha"]["palm"]
    assert isinstance(json.loads(view.made_with.values[1]), dict)
    assert view.depth_map.attrs == {"units": "m", "long_name": "depth of the maximum; NaN: nothing"}
    assert view.joint.values.tolist() == list(JOINT_NAMES)
    assert view.capture.dims == ("sample", "tx", "rx", "frequency_hz")
    assert view.tx_m.shape == (12, 3)
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.25, 0.35), 0.01)
    np.testing.assert_array_equal(view.z_m.values, grid.z_m)
    labels = labels_of(PLAN)
    assert {name for name, label in labels.items() if label.axes} <= set(view.data_vars)
    assert view.attrs["complete"] == 1


def test_xarray_reads_lazily_wherever_it_goes_on(made, tmp_path, monkeypatch):
    folder = Path(shutil.copytree(made, tmp_path / "copy"))
    monkeypatch.chdir(tmp_path)
    view = pickle.loads(pickle.dumps(open_dataset("copy")))
    monkeypatch.chdir(folder)
    assert view.volume.chunks is not None
    (folder / "shards" / "shard-00001.h5").unlink()
    assert view.volume[0].values.any()
    with pytest.raises(MeasurementError, match="shard-00001"):
        view.volume[2].compute()


@pytest.fixture
def torch(monkeypatch):
    """Stand in for PyTorch, which is too large to be installed for this: of it `as_tensor` is used.

    What it returns is an array, so that values can be looked at.
    """
    module = types.ModuleType("torch")
    module.as_tensor = np.asarray
    monkeypatch.setitem(sys.modules, "torch", module)


@pytest.mark.usefixtures("torch")
def test_torch_gets_tensors_and_numbers_of_classes(made):
    names = ("max_projection", "joints", "alpha", "pose", "handedness", "sample")
    data = TorchDataset(made, names)
    assert len(data) == 5
    assert data.poses == ("A", "B", "F")
    view = open_dataset(made)
    for at in (0, -1, 2):
        sample = data[at]
        assert tuple(sample) == names
        np.testing.assert_array_equal(sample["joints"], view.joints[at].values)
        np.testing.assert_array_equal(sample["max_projection"], view.max_projection[at].values)
        assert data.poses[int(sample["pose"])] == view.pose[at]
        assert ("right", "left")[int(sample["handedness"])] == view.handedness[at]
        assert int(sample["sample"]) == view.sample[at]
    other = pickle.loads(pickle.dumps(data))
    np.testing.assert_array_equal(other[1]["alpha"], data[1]["alpha"])
    with pytest.raises(IndexError):
        data[5]
    assert TorchDataset(made, ("pose",), transform=lambda s: int(s["pose"]) + 10)[2] == 12
    with pytest.raises(ModelError, match="'mesh'"):
        TorchDataset(made, ("mesh",))


def test_what_is_not_installed_is_named(made, monkeypatch):
    for name in ("xarray", "torch"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=r"pip install xarray 'dask\[array\]'"):
        open_dataset(made)
    data = TorchDataset(made)
    assert len(data) == 5
    with pytest.raises(ClradarError, match="expected PyTorch"):
        data[0]

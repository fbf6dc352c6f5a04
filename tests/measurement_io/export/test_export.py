"""Exported files, opened by the programs that they are for."""

import json

import numpy as np
import pytest
import scipy.io
import trimesh

import clradar
from clradar.errors import ModelError, OutputError
from measurement_io import export, export_file

META = {"seed": 7, "note": "läb <1>"}
RNG = np.random.default_rng(0)


def noise(*shape):
    return (RNG.normal(size=shape) + 1j * RNG.normal(size=shape)).astype(np.complex64)


def capture():
    array = clradar.AntennaArray(RNG.normal(size=(3, 3)), RNG.normal(size=(2, 3)), "läb 1")
    return clradar.Capture(noise(3, 2, 5), array, clradar.Waveform.sfcw(72e9, 82e9, 5), META)


def volume(counts=(4, 3, 5)):
    grid = clradar.VoxelGrid([-0.02, 1 / 30, 0.3], [1e-3, 2e-3, 0.7e-3], counts)
    return clradar.Volume(noise(*grid.shape), grid, META)


def depth(depth_m):
    """Pixels of 1 mm by 2 mm; the amplitude falls by a factor of two from pixel to pixel."""
    depth_m = np.asarray(depth_m, float)
    rows, columns = depth_m.shape
    amplitude = 0.5 ** np.arange(depth_m.size).reshape(depth_m.shape)
    return clradar.DepthMap(
        depth_m, amplitude, 1e-3 * np.arange(columns), 2e-3 * np.arange(rows), 12.0
    )


RECORDS = {"capture": capture(), "volume": volume(), "depth": volume().depth_map()}


@pytest.mark.parametrize("counts", [(4, 3, 5), (1, 1, 1)])
def test_image_data_for_paraview(tmp_path, counts):
    # VTK 9.7.2 itself, of 140 MB, read the same by hand.
    vtkio = pytest.importorskip("vtkio.reader", reason="needs pip install '.[vtk]'")
    image = volume(counts)
    export_file(tmp_path / "v.vti", image)
    read = vtkio.read_vtkxml_data(str(tmp_path / "v.vti"))
    ends = read.grid.whole_extents.tolist()
    assert ends == [0, counts[0] - 1, 0, counts[1] - 1, 0, counts[2] - 1]
    np.testing.assert_allclose(read.grid.origin, image.grid.origin_m, rtol=1e-6)  # it reads float32
    np.testing.assert_allclose(read.grid.spacing, image.grid.spacing_m, rtol=1e-6)
    # Points are counted along x first, then y, then z.
    parts = read.point_data["image"]
    z, y, x = image.grid.shape
    for i in range(z * y * x):
        at = image.data[i // (x * y), i // x % y, i % x]
        assert parts[i].tolist() == [at.real, at.imag]
    np.testing.assert_array_equal(read.point_data["amplitude"], np.abs(image.data).ravel())


def test_surfaces_for_mesh_viewers(tmp_path):
    nan = np.nan
    # Of eight triangles three are left: the others have the missing pixel or the step of 20 mm.
    image = depth([[0.30, 0.301, 0.302], [0.30, 0.301, nan], [0.32, 0.301, 0.303]])
    export_file(tmp_path / "d.ply", image)
    mesh = trimesh.load(tmp_path / "d.ply", process=False)
    np.testing.assert_allclose(mesh.vertices, image.points_m(), rtol=1e-7)  # float32
    assert len(mesh.faces) == 3
    used = set(mesh.faces.ravel().tolist())
    assert 5 not in used  # the corner behind the step
    assert (mesh.face_normals[:, 2] < 0).all()  # towards the radar
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(raw["amplitude"].ravel(), image.amplitude[image.mask])
    grey = mesh.visual.vertex_colors[:, 0]
    # 12 dB is a factor of 3.98 in amplitude: the third pixel is the last that is not black.
    assert (grey[0], grey[1], grey[3]) == (255, round(255 * (1 - 20 * np.log10(2) / 12)), 0)


def test_a_surface_of_a_row_is_points(tmp_path):
    image = depth([[0.3, 0.301]])
    export_file(tmp_path / "d.ply", image)
    cloud = trimesh.load(tmp_path / "d.ply")
    np.testing.assert_allclose(cloud.vertices, image.points_m(), rtol=1e-7)
    with pytest.raises(ModelError, match="a depth map with a depth"):
        export_file(tmp_path / "e.ply", depth([[np.nan]]))
    assert not (tmp_path / "e.ply").exists()


def contents(record):
    if isinstance(record, clradar.Capture):
        axes = {"frequency_hz": record.waveform.frequencies_hz}
        positions = {"tx_m": record.array.tx_m, "rx_m": record.array.rx_m}
        return {"data": record.data, **axes, **positions}
    if isinstance(record, clradar.Volume):
        grid = record.grid
        return {"data": record.data, "x_m": grid.x_m, "y_m": grid.y_m, "z_m": grid.z_m}
    names = ("depth_m", "amplitude", "x_m", "y_m")
    return {name: getattr(record, name) for name in names}


@pytest.mark.parametrize("suffix", ["npz", "mat"])
@pytest.mark.parametrize("kind", RECORDS)
def test_arrays_by_name(tmp_path, kind, suffix):
    record, path = RECORDS[kind], tmp_path / f"r.{suffix}"
    export_file(path, record)
    if suffix == "mat":
        found = scipy.io.loadmat(path)
    else:
        with np.load(path, allow_pickle=False) as file:
            found = dict(file)
    for name, value in contents(record).items():
        column = suffix == "mat" and value.ndim == 1
        np.testing.assert_array_equal(found[name], value[:, None] if column else value)
        assert found[name].dtype == value.dtype
    if kind == "depth":
        assert found["dynamic_range_db"] == 15.0
    else:
        assert json.loads(np.ravel(found["provenance"])[0]) == META
    if kind == "capture":
        assert np.ravel(found["array_name"])[0] == "läb 1"


def test_a_matlab_file_has_a_largest_array(tmp_path, monkeypatch):
    monkeypatch.setattr(export, "MAT_BYTES", 479)
    with pytest.raises(OutputError, match=r"v\.mat: expected at most 479 bytes.*got 480"):
        export_file(tmp_path / "v.mat", volume())
    assert list(tmp_path.iterdir()) == []


def test_what_a_name_cannot_hold_is_one_clear_error(tmp_path):
    for name, kind, words in (
        ("c.vti", "capture", "a .vti file holds a volume, got a capture"),
        ("d.vti", "depth", "a .vti file holds a volume, got a depth map"),
        ("v.ply", "volume", "a .ply file holds a depth map, got a volume"),
        ("v.txt", "volume", r"ends in \.vti, \.ply, \.mat, \.npz, got '\.txt'"),
        ("v", "volume", "got ''"),
    ):
        with pytest.raises(OutputError, match=words):
            export_file(tmp_path / name, RECORDS[kind])
    with pytest.raises(ModelError, match=r"a Capture, a Volume or a DepthMap, got ndarray"):
        export_file(tmp_path / "a.npz", np.zeros(3))
    bad = clradar.Volume(np.ones((1, 1, 1)), volume((1, 1, 1)).grid, {"a": (1, 2)})
    for suffix in ("npz", "mat"):
        with pytest.raises(ModelError, match="JSON"):
            export_file(tmp_path / f"bad.{suffix}", bad)
    assert list(tmp_path.iterdir()) == []

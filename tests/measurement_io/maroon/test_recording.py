"""Whole recordings: a lazy sequence of frames, and what lies beside them."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import maroon_files as files
import maroon_products
import numpy as np
import pytest
from comparisons import refusal

from clradar.errors import MeasurementError, ModelError
from measurement_io import Recording, open_capture, open_recording, read_transform


def seed_data(seed: int, n_freq: int = 2) -> np.ndarray:
    return files.expected_data(files.random_frame(n_freq, seed=seed))


def holds(recording: Recording, seeds: list[int]) -> bool:
    """Whether the frames are those that were made with these seeds, in this order."""
    captures = list(recording)
    return len(captures) == len(seeds) and all(
        np.array_equal(c.data, seed_data(s)) for c, s in zip(captures, seeds, strict=True)
    )


refused = partial(refusal, open_recording)


def remove(radar: Path, *names: str) -> None:
    for name in names:
        (radar / "calibrated_data" / f"{name}.npy").unlink()


def test_a_sequence_of_captures(tmp_path):
    radar = files.write_recording(tmp_path / "hand" / "30", n_frames=5)
    for source in (radar, radar.parent, str(radar)):
        recording = open_recording(source)
        assert isinstance(recording, Sequence)
        assert len(recording) == 5
        assert recording.path == radar
        assert recording.frame_numbers == (0, 1, 2, 3, 4)
        assert (recording.variant, recording.variants) == ("raw", ("raw", "emptyfiltered"))
        assert holds(recording, [0, 1, 2, 3, 4])
    assert np.array_equal(recording[np.int64(3)].data, seed_data(3))
    assert recording[-1].meta == open_capture(radar, frame=4).meta
    assert "5 frames, raw" in repr(recording)
    for index in (5, -6):
        with pytest.raises(IndexError, match="of 5"):
            recording[index]
    with pytest.raises(TypeError):
        recording["0"]


def test_slices_are_recordings(tmp_path):
    recording = open_recording(files.write_recording(tmp_path / "30", n_frames=5))
    assert holds(recording[1:4], [1, 2, 3])
    assert holds(recording[::-2], [4, 2, 0])
    assert holds(recording[1:][1:][:1], [2])
    assert holds(recording[3:3], [])
    assert recording[1:4].frame_numbers == (1, 2, 3)
    assert np.array_equal(recording[2:][-1].data, seed_data(4))
    assert len(recording) == 5


def test_variants(tmp_path):
    radar = files.write_recording(tmp_path / "30", n_frames=4)
    remove(radar, "000001_emptyfiltered")
    recording = open_recording(radar)
    filtered = recording.with_variant("emptyfiltered")
    assert holds(filtered, [100, 102, 103])
    assert {c.meta["variant"] for c in filtered} == {"emptyfiltered"}
    assert filtered.frame_numbers == (0, 2, 3)
    assert holds(open_recording(radar, variant="emptyfiltered"), [100, 102, 103])
    assert holds(filtered.with_variant("raw"), [0, 1, 2, 3])
    assert holds(recording[2:].with_variant("emptyfiltered"), [102, 103])
    with pytest.raises(
        MeasurementError, match=r"frames 1 of the variant 'emptyfiltered', got 0, 2"
    ):
        recording[:2].with_variant("emptyfiltered")
    with pytest.raises(ModelError, match="variant"):
        recording.with_variant("filtered")
    with pytest.raises(ModelError, match="variant"):
        open_recording(radar, variant="filtered")
    remove(radar, *(f"00000{i}_emptyfiltered" for i in (0, 2, 3)))
    assert open_recording(radar).variants == ("raw",)
    assert "no frame of this variant" in refused(radar, variant="emptyfiltered")


def test_intact_frames_beside_damaged_ones_are_readable(tmp_path):
    radar = files.write_recording(tmp_path / "30", n_frames=6)
    data = radar / "calibrated_data"
    cut = (data / "000000.npy").read_bytes()
    (data / "000000.npy").write_bytes(cut[: len(cut) // 2])
    files.write_frame(data / "000002.npy", files.random_frame() | {"xr": np.zeros((3, 3, 2), "c8")})
    files.write_frame(data / "000004.npy", files.random_frame(3))
    recording = open_recording(radar)
    good, named = {}, []
    frames = iter(recording)
    for number in recording.frame_numbers:
        try:
            good[number] = next(frames).data
        except MeasurementError as error:
            named.append(str(error))
    assert sorted(good) == [1, 3, 5]
    for number, message in zip((0, 2, 4), named, strict=True):
        assert f"{number:06d}.npy" in message
    assert all(np.array_equal(data, seed_data(n)) for n, data in good.items())
    # Of a fresh one, so that no frame has been read: the last frame is read before the first.
    assert np.array_equal(open_recording(radar)[-1].data, seed_data(5))
    assert recording.timestamps_us[0] is None
    with pytest.raises(MeasurementError, match=r"000000\.npy"):
        recording[0]


@pytest.mark.parametrize("read_before", [[], [0], [2, 1]])
def test_a_frame_of_other_frequencies_is_refused(tmp_path, read_before):
    radar = files.write_recording(tmp_path / "30", n_frames=4, n_freq=3)
    frame = files.random_frame(3, seed=3)
    frame["fvec"] = np.array([72e9, 78e9, 82e9])  # the ends and the number agree with the name
    files.write_frame(radar / "calibrated_data" / "000003.npy", frame)
    recording = open_recording(radar)
    for index in read_before:
        assert np.array_equal(recording[index].data, seed_data(index, 3))
    with pytest.raises(MeasurementError, match=r"000003\.npy: expected the frequencies"):
        recording[3]
    assert np.array_equal(recording[2].data, seed_data(2, 3))


def test_folders_that_are_no_recording(tmp_path):
    assert "nothing there" in refused(tmp_path / "none")
    assert "a file" in refused(files.write_frame(tmp_path / "000000.npy", files.random_frame()))
    radar = files.write_recording(tmp_path / "hand" / "30")
    assert "30" in refused(tmp_path / "hand")
    remove(radar, "000000", "000001", "000000_emptyfiltered", "000001_emptyfiltered")
    assert "got none" in refused(radar)
    (radar / "calibrated_data").rmdir()
    assert "calibrated_data" in refused(radar)
    files.write_recording(radar.parent, n_freq=3)
    assert "radar_72.0_82.0_3" in refused(radar.parent)
    with pytest.raises(MeasurementError):
        open_recording("nul\0byte")


# ---- beside the radar folder


def test_metadata_and_alignment(tmp_path):
    radar = files.write_recording(tmp_path / "30")
    recording = open_recording(radar)
    assert recording.metadata is None
    assert recording.alignment is None
    assert recording.mesh_names == ()
    files.write_json(radar.parent / "metadata.json", {"distance_meters": 0.3})
    files.write_alignment(radar.parent, {"photogrammetry2radar": np.eye(4)})
    recording = open_recording(radar)
    assert recording.metadata.distance_meters == 0.3
    assert recording[:1].alignment is recording.alignment
    (radar.parent / "metadata.json").write_text("{")
    (radar.parent / "alignment.json").write_text("[]")
    recording = open_recording(radar)  # a damaged file beside them does not hide the frames
    assert holds(recording, [0, 1])
    for name in ("metadata", "alignment"):
        with pytest.raises(MeasurementError, match=rf"{name}\.json"):
            getattr(recording, name)


TRIANGLE = (np.array([[0.01, 0, 0], [0.05, 0, 0], [0, 0.03, 0.0]]), np.array([[0, 1, 2]]))


def test_alignments_place_the_meshes_of_their_recording(tmp_path):
    radar = files.write_recording(tmp_path / "hand" / "30", n_frames=1)
    turned = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1.0]])
    for name, matrix in (
        ("photogrammetry2radar", turned),
        ("radar2photogrammetry", np.linalg.inv(turned)),
    ):
        path = radar.parent / "alignment.json"
        path.write_text(json.dumps({name: matrix.tolist(), "kinect2radar": np.eye(4).tolist()}))
        wanted = np.diag([-1, 1, 1, 1]) @ turned
        np.testing.assert_allclose(read_transform(path), wanted, rtol=0, atol=1e-15)
    path.write_text(json.dumps({"kinect2radar": np.eye(4).tolist()}))
    with pytest.raises(MeasurementError, match="transform: expected a value, got nothing"):
        read_transform(path)


def test_a_mesh_keeps_its_outside(tmp_path):
    radar = files.write_recording(tmp_path / "30")
    vertices, faces = TRIANGLE
    files.write_mesh(radar.parent, "mesh_masked", vertices, faces)
    for mirrored, sign in ((False, 1.0), (True, -1.0)):
        matrix = files.rigid((5, 160, 30), (0.02, 0.01, 0.4))
        if mirrored:
            matrix = matrix @ np.diag([1.0, 1.0, -1.0, 1.0])
        files.write_alignment(radar.parent, {"photogrammetry2radar": matrix})
        recording = open_recording(radar)
        assert recording.mesh_names == ("mesh_masked",)
        scene = recording.scene("mesh_masked", alpha=0.25)
        in_radar = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        place = {tuple(p) for p in np.round(in_radar * (-1, 1, 1), 9)}
        assert {tuple(p) for p in np.round(scene.triangles_m[0], 9)} == place
        # Where the mesh's normal goes, the normal of the placed face points.
        normal = np.linalg.inv(matrix[:3, :3]).T @ [0, 0, 1.0] * (-1, 1, 1)
        a, b, c = scene.triangles_m[0]
        cosine = np.cross(b - a, c - a) @ normal / np.linalg.norm(np.cross(b - a, c - a))
        assert cosine == pytest.approx(1.0, abs=1e-6), sign  # nine decimals in the file
        assert (scene.alpha == 0.25).all()
        assert scene.part_names == ("mesh_masked",)


def test_meshes_that_cannot_be_placed(tmp_path):
    radar = files.write_recording(tmp_path / "30")
    path = files.write_mesh(radar.parent, "mesh", *TRIANGLE)
    with pytest.raises(MeasurementError, match=r"alignment\.json"):
        open_recording(radar).scene()
    files.write_alignment(radar.parent, {"kinect2radar": np.eye(4)})
    with pytest.raises(MeasurementError, match="from 'photogrammetry' to 'radar'"):
        open_recording(radar).scene()
    files.write_alignment(radar.parent, {"photogrammetry2radar": np.eye(4)})
    for name in ("mesh_masked", "../photogrammetry/mesh"):
        with pytest.raises(MeasurementError, match="got mesh"):
            open_recording(radar).scene(name)
    with pytest.raises(ModelError, match="alpha"):
        open_recording(radar).scene(alpha=2.0)
    for content in (
        b"",
        b"v 0 0 0\nf 1 2 3\n",
        b"v 0 0 x\nf 1 1 1\n",
        b"\xff\xfe\x00\x00",
        b"\x00",
    ):
        path.write_bytes(content)
        with pytest.raises(MeasurementError, match=r"mesh\.obj"):
            open_recording(radar).scene()


# ---- cached products


def test_depth_maps_are_those_of_the_position(tmp_path):
    radar = files.write_recording(tmp_path / "30", n_frames=4)
    remove(radar, "000001")
    at_x_m = {0: 0.02, 2: -0.04, 3: 0.06}  # radar space: minus these in the antenna frame
    for number, x_m in at_x_m.items():
        scene = maroon_products.scene([(x_m, -0.02, 0.3, 5000.0)])
        maroon_products.write_products(radar, number, scene)
    (radar / "depth" / "000003.png").unlink()
    recording = open_recording(radar)
    for index, x_m in ((0, 0.02), (1, -0.04), (-2, -0.04)):
        depth = recording.depth_map(index)
        y, x = np.unravel_index(int(depth.amplitude.argmax()), depth.amplitude.shape)
        assert depth.x_m[x] == pytest.approx(-x_m, abs=0.005)  # pixels of 8 mm
        assert depth.depth_m[y, x] == pytest.approx(0.3, abs=1e-9)
    assert recording[1:].depth_map(0).x_m[0] == recording.depth_map(1).x_m[0]
    with pytest.raises(MeasurementError, match=r"depth.*frame 3"):
        recording.depth_map(2)
    with pytest.raises(IndexError):
        recording.depth_map(3)

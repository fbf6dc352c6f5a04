"""Recordings: what is read of frames, a lazy sequence of them, and what lies beside them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import maroon_files as files
import numpy as np
import pytest
from comparisons import refusal, same_bits

import clradar
import measurement_io
from clradar.errors import MeasurementError, ModelError
from measurement_io import check_file, open_capture, open_recording, read_transform, save_recording

refused = partial(refusal, open_capture)
no_recording = partial(refusal, open_recording)


# ---- what is read of a frame


@pytest.mark.parametrize(
    ("protocol", "spelling"), [*zip(files.PROTOCOLS, 2 * files.SPELLINGS, strict=True)]
)
def test_every_protocol_and_spelling(tmp_path, protocol, spelling):
    frame = files.random_frame()
    frame |= {"complex": 1 + 2j, "gain": np.float32(0.5), "z": np.complex64(1j), "note": "hand"}
    raw = files.pickled(frame, protocol, spelling)
    path = tmp_path / "000000.npy"
    path.write_bytes(files.npy(raw))

    capture = open_capture(path)

    assert same_bits(capture.data, files.expected_data(frame))
    assert same_bits(capture.waveform.frequencies_hz, frame["fvec"])
    assert capture.meta == {
        "source": str(path),
        "format": "maroon",
        "frame": 0,
        "variant": "raw",
        "timestamp_us": 1_700_000_000_000_123,
        "number_of_measurements": 3,
        "gain": 0.5,
        "note": "hand",
    }


def test_keys_of_no_use_are_left_out(tmp_path):
    frame = files.random_frame() | {
        "settings": {"a": [1, (2, 3)]},
        "when": np.array(["2024-01-01"], dtype="datetime64[D]"),
        "rows": np.zeros(2, dtype=[("a", "f4")]),
        "objects": np.array([{}, None], dtype=object),
        "not_finite": float("nan"),
        "frame": 77,
        5: 6,
    }
    meta = open_capture(files.write_frame(tmp_path / "f.npy", frame)).meta
    known = {"source", "format", "frame", "variant", "timestamp_us", "number_of_measurements"}
    assert set(meta) == known | {"file_frame"}
    assert (meta["frame"], meta["file_frame"]) == (None, 77)


LARGE = np.zeros((96, 96, 2), np.complex128)
LARGE[40, 50, 1] = 1e60


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"xr": np.zeros((95, 96, 2), np.complex64)}, "(95, 96, 2)"),
        ({"xr": np.zeros((96, 96, 2), np.float32)}, "float32"),
        ({"xr": np.zeros((96, 96, 3), np.complex64)}, "3 in 'xr', 2 in 'fvec'"),
        ({"xr": np.zeros((96, 96, 0), np.complex64), "fvec": np.zeros(0)}, "(0,)"),
        ({"xr": [1, 2]}, "another type"),
        ({"xr": LARGE}, "an overflow"),
        ({"xr": LARGE / 1e60 * np.nan}, "17672 of 17672"),
        ({"fvec": np.array([72e9, np.nan])}, "NaN"),
        ({"fvec": np.array([72.0, 82.0])}, "got 72"),  # gigahertz
        ({"number_of_measurements": 2.5}, "2.5"),
        ({"number_of_measurements": "many"}, "many"),
    ],
)
def test_wrong_contents(tmp_path, change, found):
    path = files.write_frame(tmp_path / "f.npy", files.random_frame() | change)
    assert found in refused(path)
    assert not check_file(path).ok


def test_folder_name_disagrees(tmp_path):
    for name, found in (
        ("radar_72.0_82.0_3", "2 in 'xr', 2 in 'fvec', 3 in the folder's name"),
        ("radar_72.0_81.0_2", "72 to 82 GHz"),
    ):
        radar = files.write_recording(tmp_path / name, name=name)
        assert found in refused(radar / "calibrated_data" / "000000.npy")


# ---- antennas


def antenna_text(rows, header="x,y,z"):
    return "\n".join([header, *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"


def test_antenna_files(tmp_path):
    frame = files.write_frame(tmp_path / "f.npy", files.random_frame())
    rows = 0.1 * np.random.default_rng(0).normal(size=(96, 3))
    (tmp_path / "Rx.dat").write_text(antenna_text(rows))
    (tmp_path / "Tx.dat").write_text(antenna_text(rows[1:95] + 1))
    array = open_capture(frame, rx_file=tmp_path / "Rx.dat", tx_file=tmp_path / "Tx.dat").array
    assert same_bits(array.rx_m, rows[1:95])
    assert same_bits(array.tx_m, rows[1:95] + 1)
    array = open_capture(frame, rx_file=tmp_path / "Rx.dat").array
    assert same_bits(array.tx_m, clradar.arrays.qar50().tx_m)
    measurement_io.save_capture(tmp_path / "native.h5", open_capture(frame))
    assert "a native file" in refused(tmp_path / "native.h5", rx_file=tmp_path / "Rx.dat")


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (antenna_text(np.zeros((95, 3))), "95 rows"),
        (antenna_text(np.zeros((96, 3)), "a,b,c"), "a,b,c"),
        (antenna_text(np.full((96, 3), np.nan)), "NaN"),
        (antenna_text(np.zeros((96, 3))).replace("0.0", "zero", 1), "zero"),
    ],
)
def test_bad_antenna_files(tmp_path, content, found):
    frame = files.write_frame(tmp_path / "f.npy", files.random_frame())
    (tmp_path / "Rx.dat").write_text(content)
    assert found in refusal(lambda rx: open_capture(frame, rx_file=rx), tmp_path / "Rx.dat")


def test_other_antennas_lie_beside_their_frames_which_are_of_one_array(tmp_path):
    data, q = files.expected_data(files.random_frame(5)), clradar.arrays.qar50()
    pattern = clradar.AntennaPattern(exponent=1.0)
    array = clradar.AntennaArray(q.rx_m[:5], q.tx_m[:4], "few", pattern)
    other = clradar.Capture(data[:5, :4], array, clradar.Waveform.sfcw(72e9, 82e9, 5))
    radar = save_recording(tmp_path / "30", [other, other])
    path = radar / "calibrated_data" / "000000.npy"
    for read in (open_capture(path), open_recording(tmp_path / "30")[1]):
        np.testing.assert_array_equal(read.data, other.data)
        np.testing.assert_array_equal(read.array.tx_m, array.tx_m)
        assert (read.array.name, read.array.tx_pattern) == ("few", pattern)
    gains = replace(other, array=replace(array, tx_gain=[1, 1, 1, 1, 0.5]))
    with pytest.raises(ModelError, match="other gains or patterns"):
        save_recording(tmp_path / "60", [other, gains])
    (radar / "antennas.toml").unlink()
    assert "(96, 96, Nf) or (94, 94, Nf)" in refused(path)


# ---- a sequence of frames


def seed_data(seed, n_freq=2):
    return files.expected_data(files.random_frame(n_freq, seed=seed))


def holds(recording, seeds):
    """Whether the frames are those that were made with these seeds, in this order."""
    captures = list(recording)
    return len(captures) == len(seeds) and all(
        np.array_equal(c.data, seed_data(s)) for c, s in zip(captures, seeds, strict=True)
    )


def remove(radar, *names):
    for name in names:
        (radar / "calibrated_data" / f"{name}.npy").unlink()


def test_a_sequence_of_captures(tmp_path):
    radar = files.write_recording(tmp_path / "hand" / "30", n_frames=5)
    for source in (radar, radar.parent, str(radar)):
        recording = open_recording(source)
        assert isinstance(recording, Sequence)
        assert recording.path == radar
        assert recording.frame_numbers == (0, 1, 2, 3, 4)
        assert (recording.variant, recording.variants) == ("raw", ("raw", "emptyfiltered"))
        assert holds(recording, [0, 1, 2, 3, 4])
        capture = open_capture(source, frame=1, variant="emptyfiltered")
        assert np.array_equal(capture.data, seed_data(101))
        assert (capture.meta["frame"], capture.meta["variant"]) == (1, "emptyfiltered")
    assert np.array_equal(open_capture(radar).data, seed_data(0))
    assert "0-4" in refused(radar, frame=5)
    assert np.array_equal(recording[np.int64(3)].data, seed_data(3))
    assert recording[-1].meta == open_capture(radar, frame=4).meta
    assert "5 frames, raw" in repr(recording)
    for index in (5, -6):
        with pytest.raises(IndexError, match="of 5"):
            recording[index]
    with pytest.raises(TypeError):
        recording["0"]
    for chosen, seeds in (
        (recording[1:4], [1, 2, 3]),
        (recording[::-2], [4, 2, 0]),
        (recording[1:][1:][:1], [2]),
        (recording[3:3], []),
    ):
        assert holds(chosen, seeds)
        assert chosen.frame_numbers == tuple(seeds)


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
    missing = "frames 1 of the variant 'emptyfiltered', got 0, 2"
    with pytest.raises(MeasurementError, match=missing):
        recording[:2].with_variant("emptyfiltered")
    with pytest.raises(ModelError, match="variant"):
        recording.with_variant("filtered")
    with pytest.raises(ModelError, match="variant"):
        open_recording(radar, variant="filtered")
    remove(radar, *(f"00000{i}_emptyfiltered" for i in (0, 2, 3)))
    assert open_recording(radar).variants == ("raw",)
    assert "no frame of this variant" in no_recording(radar, variant="emptyfiltered")


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


@pytest.mark.parametrize("read_before", [[], [2, 1]])
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
    assert "nothing there" in no_recording(tmp_path / "none")
    frame = files.write_frame(tmp_path / "000000.npy", files.random_frame())
    assert "a file" in no_recording(frame)
    radar = files.write_recording(tmp_path / "hand" / "30")
    assert "30" in no_recording(tmp_path / "hand")
    remove(radar, "000000", "000001", "000000_emptyfiltered", "000001_emptyfiltered")
    assert "got none" in no_recording(radar)
    (radar / "calibrated_data").rmdir()
    assert "calibrated_data" in no_recording(radar)
    files.write_recording(radar.parent, n_freq=3)
    assert "radar_72.0_82.0_3" in no_recording(radar.parent)
    with pytest.raises(MeasurementError):
        open_recording("nul\0byte")


# ---- beside the radar folder


def test_metadata_and_alignment(tmp_path):
    radar = files.write_recording(tmp_path / "30")
    recording = open_recording(radar)
    assert (recording.metadata, recording.alignment, recording.mesh_names) == (None, None, ())
    files.write_json(radar.parent / "metadata.json", {"distance_meters": 0.3})
    files.write_alignment(radar.parent, {"photogrammetry2radar": np.eye(4)})
    recording = open_recording(radar)
    assert recording.metadata == {"distance_meters": 0.3}
    assert recording[:1].alignment is recording.alignment
    for name, damaged in (("metadata", "{"), ("alignment", "[]")):
        (radar.parent / f"{name}.json").write_text(damaged)
        recording = open_recording(radar)  # which does not hide the frames
        assert holds(recording, [0, 1])
        with pytest.raises(MeasurementError, match=rf"{name}\.json"):
            getattr(recording, name)


TRIANGLE = (np.array([[0.01, 0, 0], [0.05, 0, 0], [0, 0.03, 0.0]]), np.array([[0, 1, 2]]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_mesh_keeps_its_outside(tmp_path, sign):
    radar = files.write_recording(tmp_path / "30")
    vertices, faces = TRIANGLE
    files.write_mesh(radar.parent, "mesh_masked", vertices, faces)
    matrix = files.rigid((5, 160, 30), (0.02, 0.01, 0.4)) @ np.diag([1.0, 1.0, sign, 1.0])
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
    assert cosine == pytest.approx(1.0, abs=1e-6)  # nine decimals in the file
    assert (scene.alpha == 0.25).all()
    assert scene.part_names == ("mesh_masked",)


def test_meshes_that_cannot_be_placed(tmp_path):
    radar = files.write_recording(tmp_path / "30")
    path = files.write_mesh(radar.parent, "mesh", *TRIANGLE)
    with pytest.raises(MeasurementError, match=r"alignment\.json"):
        open_recording(radar).scene()
    alignment = files.write_alignment(radar.parent, {"kinect2radar": np.eye(4)})
    assert "transform: expected a value, got nothing" in refusal(read_transform, alignment)
    with pytest.raises(MeasurementError, match="from 'photogrammetry' to 'radar'"):
        open_recording(radar).scene()
    files.write_alignment(radar.parent, {"photogrammetry2radar": np.eye(4)})
    assert np.array_equal(read_transform(alignment), np.diag([-1.0, 1, 1, 1]))
    for name in ("mesh_masked", "../photogrammetry/mesh"):
        with pytest.raises(MeasurementError, match="got mesh"):
            open_recording(radar).scene(name)
    with pytest.raises(ModelError, match="alpha"):
        open_recording(radar).scene(alpha=2.0)
    path.write_bytes(b"v 0 0 0\nf 1 2 3\n")
    with pytest.raises(MeasurementError, match=r"mesh\.obj"):
        open_recording(radar).scene()


def test_depth_maps_are_those_of_the_position(tmp_path):
    radar = files.write_recording(tmp_path / "30", n_frames=4)
    remove(radar, "000001")
    at_x_m = {0: 0.02, 2: -0.04, 3: 0.06}  # radar space: minus these in the antenna frame
    for number, x_m in at_x_m.items():
        scene = files.scene([(x_m, -0.02, 0.3, 5000.0)])
        files.write_products(radar, number, scene)
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

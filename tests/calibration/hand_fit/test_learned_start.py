"""Pictures that do not depend on the place, and models that predict poses from them."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from scipy.spatial.transform import Rotation

from calibration.hand_fit import learned_start
from calibration.hand_fit.hand_picture import PIXELS, _step_m, hand_picture
from calibration.hand_fit.hand_state import angles_of
from calibration.hand_fit.learned_start import (
    LETTERS_TRIED,
    N_INPUTS,
    LearnedStart,
    prediction_of,
    start_metadata,
    target_of,
    wrist_of,
)
from calibration.hand_fit.starts import starts_of
from clradar.errors import CompareError, MeasurementError, MissingPackage
from clradar.hand import LETTERS, POSES, HandPose, posed_skeleton
from clradar.model import DepthMap

FLOAT32 = 1e-6
"""Values of order 1 of a model in single precision."""


def blobs(
    moved_m=(0.0, 0.0, 0.0), step_m: float = 2e-3, level: float = 1.0, mirrored: bool = False
) -> DepthMap:
    """Three smooth blobs, each at its own depth, about a place."""
    half = round(0.15 / step_m)
    x_m = y_m = np.arange(-half, half + 1) * step_m
    x, y = np.meshgrid(x_m - moved_m[0], y_m - moved_m[1])
    x = -x if mirrored else x
    places = ((0.0, 0.0, 1.0), (0.03, 0.02, 0.6), (-0.02, 0.05, 0.4))
    parts = [a * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 0.012**2)) for u, v, a in places]
    depth_m = 0.3 + moved_m[2] + 0.2 * x + 0.1 * y
    amplitude = level * sum(parts)
    depth_m = np.where(amplitude > 0.1 * amplitude.max(), depth_m, np.nan)
    return DepthMap(depth_m, amplitude, x_m, y_m, 20.0)


def turn(pose: HandPose) -> np.ndarray:
    return posed_skeleton(HandPose("wrist", {"wrist": pose.angles("wrist")})).frames[0]


@pytest.fixture(scope="module")
def row() -> np.ndarray:
    """What a model should say of an L that is turned a little."""
    return target_of(POSES["L"], np.radians([4.0, -6.0, 9.0]))


def write_model(path: Path, bias: np.ndarray, about=None, n_inputs: int = N_INPUTS) -> Path:
    """A linear model of the mean brightness: `bias`, and as much more of the score of A."""
    weights = np.zeros((n_inputs, len(bias)), np.float32)
    weights[: PIXELS**2, -len(LETTERS)] = 1.0 / PIXELS**2
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Gemm", ["x", "weights", "bias"], ["y"])],
        "linear",
        [onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [None, n_inputs])],
        [onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [None, len(bias)])],
        [
            onnx.numpy_helper.from_array(weights, "weights"),
            onnx.numpy_helper.from_array(bias.astype(np.float32), "bias"),
        ],
    )
    opset = [onnx.helper.make_opsetid("", 17)]
    model = onnx.helper.make_model(graph, opset_imports=opset, ir_version=8)
    onnx.helper.set_model_props(model, start_metadata() if about is None else about)
    path.write_bytes(model.SerializeToString())
    return path


def test_a_picture_does_not_depend_on_place_level_or_pixels() -> None:
    here = hand_picture(blobs())
    assert here.shape == (3, PIXELS, PIXELS)
    # A move by whole pixels moves the samples alone; the depth's clipped tilt moves with the hand.
    moved = hand_picture(blobs((0.02, -0.012, 0.04), level=50.0))
    np.testing.assert_allclose(moved, here, atol=1e-4)
    # Pixels of 3 mm shift the medians by up to 1.5 mm, 0.3 of a pixel of the picture, of blobs that
    # fall from 1 to 0 over five: 0.06 in brightness, twice that in depth, whose range is 4.
    for step_m in (1e-3, 3e-3):
        other = hand_picture(blobs(step_m=step_m))
        assert np.sqrt(np.mean((other - here) ** 2, axis=(1, 2))).max() < 0.1
    assert here[0, 24, 26] > here[0, 24, 13]  # the blob at x = 0.03 is to the right of the middle
    assert _step_m(np.linspace(0.1, 0.2, 11)) == pytest.approx(0.01)
    assert 0.9 < here[0].max() <= 1.0
    assert here[0, 0, 0] == 0.0


def test_the_picture_of_a_left_hand_is_that_of_the_mirrored_right_one() -> None:
    right, left = hand_picture(blobs()), hand_picture(blobs(mirrored=True), "left")
    np.testing.assert_allclose(left, right, atol=1e-4)
    wrong = hand_picture(blobs(mirrored=True))
    assert np.sqrt(np.mean((right - wrong) ** 2)) > 0.1


def test_nothing_is_seen_in_a_dark_image() -> None:
    seen = blobs()
    dark = replace(seen, amplitude=np.zeros_like(seen.amplitude))
    nowhere = replace(seen, depth_m=np.full(seen.depth_m.shape, np.nan))
    for image in (dark, nowhere):
        with pytest.raises(CompareError, match="because the image is empty"):
            hand_picture(image)


def test_the_wrist_turns_the_hand_as_a_rotation_does() -> None:
    for letter in LETTERS:
        np.testing.assert_allclose(
            turn(HandPose("w", {"wrist": wrist_of(turn(POSES[letter]))})),
            turn(POSES[letter]),
            atol=1e-9,
        )
    # A mean of rotations is none: the nearest one counts.
    small = Rotation.from_euler("xyz", [10, -5, 7], degrees=True).as_matrix()
    found = turn(HandPose("w", {"wrist": wrist_of(0.6 * small)}))
    np.testing.assert_allclose(found, small, atol=1e-9)


def test_a_prediction_is_what_was_to_be_predicted(row: np.ndarray) -> None:
    found = prediction_of(row, "seen")
    assert found.pose.name == "seen"
    np.testing.assert_allclose(angles_of(found.pose), angles_of(POSES["L"]), atol=1e-12)
    turned = Rotation.from_euler("xyz", [4, -6, 9], degrees=True).as_matrix() @ turn(POSES["L"])
    np.testing.assert_allclose(turn(found.pose), turned, atol=1e-9)
    assert found.letters()[0] == "L"
    assert [pose.name for pose in found.starts()][:2] == ["seen", "L"]
    # Angles that no hand has are cut at the limits of the joints.
    assert angles_of(prediction_of(row + 10.0).pose).max() < np.pi


def test_a_model_is_read_and_asked(tmp_path: Path, row: np.ndarray) -> None:
    path = write_model(tmp_path / "taught.onnx", row)
    model = LearnedStart.read(path)
    found = model.predict(blobs())
    assert found.pose.name == "taught"
    np.testing.assert_allclose(angles_of(found.pose), angles_of(POSES["L"]), atol=FLOAT32)
    brightness = float(hand_picture(blobs())[0].mean())
    assert found.scores["A"] == pytest.approx(brightness, abs=FLOAT32)
    assert found.letters()[:2] == ["L", "A"]
    # As one of the starts of a fit, by its file too.
    for given in (model, path, str(path)):
        flat, learned = starts_of(["flat", given])
        assert flat.seen_in(blobs(), "right") == (flat,)
        seen = learned.seen_in(blobs(), "right")
        assert [one.pose.name for one in seen[:3]] == ["taught", "L", "A"]
        assert len(seen) == 1 + LETTERS_TRIED
        assert all(one.transform is None and one.learned is None for one in seen)


def test_a_model_of_something_else_is_refused(tmp_path: Path, row: np.ndarray) -> None:
    about = start_metadata()
    foreign = {
        "no metadata": write_model(tmp_path / "none.onnx", row, {}),
        "clradar_version '1', got '2'": write_model(
            tmp_path / "new.onnx", row, {**about, "clradar_version": "2"}
        ),
        "of this version": write_model(tmp_path / "other.onnx", row, {**about, "about": "{}"}),
        f"{N_INPUTS} inputs": write_model(tmp_path / "few.onnx", row, n_inputs=PIXELS**2),
        "outputs of": write_model(tmp_path / "short.onnx", row[1:]),
    }
    for words, path in foreign.items():
        with pytest.raises(MeasurementError) as caught:
            LearnedStart.read(path)
        said = str(caught.value)
        assert said.startswith(f"{path}: expected a learned start (an ONNX file")
        assert "\n" not in said
        assert words == "no metadata" or words in said
    with pytest.raises(MeasurementError, match="not finite"):
        LearnedStart.read(write_model(tmp_path / "nan.onnx", row * np.nan)).predict(blobs())


def test_a_file_that_is_no_model_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, row: np.ndarray
) -> None:
    path = tmp_path / "start.onnx"
    with pytest.raises(MeasurementError, match=r"start\.onnx: expected a learned start"):
        LearnedStart.read(path)
    whole = write_model(path, row).read_bytes()
    for content in (b"", b"no model", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(MeasurementError) as caught:
            LearnedStart.read(path)
        assert str(caught.value).startswith(f"{path}: expected a learned start")
        assert "\n" not in str(caught.value)
    monkeypatch.setattr(learned_start, "MAX_ONNX_BYTES", 3)
    with pytest.raises(MeasurementError, match="of at most 3 bytes"):
        LearnedStart.read(path)


def test_without_onnx_runtime_the_error_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, row: np.ndarray
) -> None:
    path = write_model(tmp_path / "start.onnx", row)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingPackage, match=r"pip install 'clradar\[learned\]'"):
        LearnedStart.read(path)

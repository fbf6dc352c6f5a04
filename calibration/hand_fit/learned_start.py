"""A start of the fit that a model predicts from the image: ONNX files of examples/train_pose.py."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.hand_fit import hand_picture as picture
from calibration.hand_fit.hand_state import FITTED_ANGLES, angles_of, pose_with
from clradar.errors import MeasurementError, MissingPackage
from clradar.files.failures import clean, fail, read_bytes, shown
from clradar.files.limits import MAX_ONNX_BYTES
from clradar.hand import (
    JOINT_NAMES,
    LETTERS,
    LIMITS_DEG,
    POSES,
    HandPose,
    JointAngles,
    posed_skeleton,
)
from clradar.model import DepthMap

SUFFIX = ".onnx"

INSTALL = "pip install 'clradar[learned]'"

N_INPUTS = 3 * picture.PIXELS**2

OUTPUTS = {"angles_rad": len(FITTED_ANGLES), "rotation": 9, "letters": len(LETTERS)}
"""Columns of the prediction, in this order: angles of `FITTED_ANGLES`; the matrix, row by row, that
the frame of a hand without wrist angles is turned by; a score of every letter."""

LETTERS_TRIED = 3

_EXPECTED = "a learned start (an ONNX file that examples/train_pose.py wrote)"


def start_metadata() -> dict[str, str]:
    """Return what a model says of itself: everything that its inputs and outputs depend on."""
    about = {
        "inputs": f"{N_INPUTS}: brightness, depth, share of depths; rows, columns",
        "pixels": picture.PIXELS,
        "pixel_m": picture.PIXEL_M,
        "brightness_db": picture.BRIGHTNESS_DB,
        "mask_db": picture.MASK_DB,
        "depth_m": picture.DEPTH_M,
        "least_share": picture.LEAST_SHARE,
        "outputs": OUTPUTS,
        "angles_rad": [" ".join(names) for names in FITTED_ANGLES],
        "letters": "".join(LETTERS),
    }
    return {"clradar_format": "learned-start", "clradar_version": "1", "about": json.dumps(about)}


def target_of(pose: HandPose, rotation_rad: np.ndarray) -> np.ndarray:
    """Return what a model should predict of a sample of a data set.

    Parameters
    ----------
    pose : HandPose
        Its name counts if it is a letter.
    rotation_rad : ndarray, shape (3,), radians
        Of the posed hand about the axes of the antenna frame, x first, then y, then z.

    Returns
    -------
    ndarray, shape (56,)
        The columns of `OUTPUTS`.
    """
    from scipy.spatial.transform import Rotation

    wrist = posed_skeleton(HandPose("wrist", {"wrist": pose.angles("wrist")})).frames[0]
    turned = Rotation.from_euler("xyz", rotation_rad).as_matrix() @ wrist
    return np.concatenate(
        [angles_of(pose), turned.ravel(), [float(pose.name == letter) for letter in LETTERS]]
    )


def samples_of(data: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what a model can learn from a data set.

    Parameters
    ----------
    data : xarray.Dataset
        Of `clradar.open_dataset`, with the products max_projection and depth_map.

    Returns
    -------
    inputs : ndarray, shape (n, N_INPUTS), float32
    outputs : ndarray, shape (n, 56), float64
        See `target_of`. Left hands are as their mirror images.
    unseen : ndarray, shape (n,), bool
        Every fourth round of poses, to test the model with.
    """
    inputs, outputs = [], []
    names = data.pose.values.astype(str)
    keys = ("depth_map", "max_projection", "handedness", "angles_rad", "rotation_rad")
    for name, *values in zip(names, *(data[key].values for key in keys), strict=True):
        depth_m, amplitude, handedness, angles_rad, turn_rad = values
        image = DepthMap(depth_m, amplitude, data.x_m.values, data.y_m.values, picture.MASK_DB)
        joints = zip(JOINT_NAMES, (JointAngles(*a) for a in angles_rad.tolist()), strict=True)
        mirrored = turn_rad * (1.0 if handedness == "right" else np.array([1.0, -1.0, -1.0]))
        inputs.append(picture.hand_picture(image, str(handedness)).ravel())
        outputs.append(target_of(HandPose(name, dict(joints)), mirrored))
    unseen = data.sample.values // len(set(names)) % 4 == 3
    return np.array(inputs), np.array(outputs), unseen


@dataclass(frozen=True, slots=True, eq=False)
class LearnedStart:
    """A model that predicts the pose of a hand from its depth map.

    `fit_hand(measured, pose=LearnedStart.read("start.onnx"))` starts at the angles that it
    predicts, and at the letters that it finds likeliest.

    Attributes
    ----------
    name : str
        That of the predicted poses.

    Examples
    --------
    `examples/train_pose.py` trains a model; a file of something else is refused.

    >>> from pathlib import Path
    >>> from clradar.calibration import LearnedStart
    >>> _ = Path("other.onnx").write_bytes(b"no model")
    >>> LearnedStart.read("other.onnx")
    Traceback (most recent call last):
    clradar.errors.MeasurementError: other.onnx: ...
    """

    name: str
    _session: Any

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> LearnedStart:
        """Read a model, which is a program that ONNX Runtime runs: only one that you trust.

        Raises
        ------
        MeasurementError
            The file is missing, larger than 64 MiB, no ONNX file, or a model of something else.
        MissingPackage
            onnxruntime is not installed.
        """
        path = Path(path)
        content = read_bytes(path, _EXPECTED, MAX_ONNX_BYTES)
        try:
            import onnxruntime
        except ImportError as error:
            raise MissingPackage(
                f"{shown(path)}: learned starts need ONNX Runtime: {INSTALL} ({error})"
            ) from error
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # its errors are raised as well
        # The order of its sums does not depend on the machine's other work.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # it has a class of its own for every status
            fail(path, _EXPECTED, f"one that ONNX Runtime refuses: {clean(error)}", cause=error)
        _check(session, path)
        return cls(path.stem, session)

    def predict(self, depth: DepthMap, handedness: str = "right") -> Prediction:
        """Return what the model sees in an image.

        Parameters
        ----------
        depth : DepthMap
        handedness : "right" or "left"

        Raises
        ------
        CompareError
            The image is empty.
        MeasurementError
            The model's numbers are not finite.
        """
        return self.predict_picture(picture.hand_picture(depth, handedness))

    def predict_picture(self, inputs: np.ndarray) -> Prediction:
        """Return what the model sees in a picture of `hand_picture`; raises as `predict` does."""
        (name,) = (node.name for node in self._session.get_inputs())
        given = {name: inputs.reshape(1, N_INPUTS)}
        found = np.asarray(self._session.run(None, given)[0], np.float64).ravel()
        if not np.isfinite(found).all():
            raise MeasurementError(f"{clean(self.name)}: the model's prediction is not finite")
        return prediction_of(found, self.name)


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a model sees in an image.

    Attributes
    ----------
    pose : HandPose
        Mean of the joint angles; the wrist's turn the hand as it is in the antenna frame, a left
        one after mirroring.
    scores : dict of str to float
        Of the letters: the least-squares estimate of their probability, not normalised.
    """

    pose: HandPose
    scores: dict[str, float]

    def letters(self) -> list[str]:
        """All letters, the likeliest first."""
        return sorted(self.scores, key=lambda letter: -self.scores[letter])

    def starts(self) -> tuple[HandPose, ...]:
        """Poses to start a fit from: the mean, and the likeliest letters, since a mean of several
        hands that look alike may be none of them."""
        return (self.pose, *(POSES[letter] for letter in self.letters()[:LETTERS_TRIED]))


def prediction_of(columns: np.ndarray, name: str = "learned") -> Prediction:
    """Return what a row of a model's outputs, shape (56,), says; see `target_of`."""
    angles_rad, rotation, scores = np.split(columns, np.cumsum(list(OUTPUTS.values()))[:-1])
    turned = HandPose(name, {"wrist": wrist_of(rotation.reshape(3, 3))})
    return Prediction(
        pose_with(turned, angles_rad), dict(zip(LETTERS, scores.tolist(), strict=True))
    )


def wrist_of(matrix: np.ndarray) -> JointAngles:
    """Return the angles of the wrist that turn the hand like the rotation nearest to a matrix.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3)

    Notes
    -----
    The rotation is X(-flexion) Z(abduction) Y(-twist), see `clradar.hand.skeleton`. Of its two
    solutions the one counts that is less outside the limits of the wrist, to which it is clipped.
    """
    from scipy.spatial.transform import Rotation

    left, _, right = np.linalg.svd(matrix)
    nearest = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    with warnings.catch_warnings():
        # G and H turn the abduction by 90 degrees, where the other two angles are one.
        warnings.filterwarnings("ignore", "Gimbal lock", UserWarning)
        about = Rotation.from_matrix(nearest).as_euler("XZY", degrees=True) * [-1.0, 1.0, -1.0]
    other = about * [1.0, -1.0, 1.0] + 180.0
    limits_deg = np.array(list(LIMITS_DEG["wrist"].values())).T

    def clipped(angles_deg: np.ndarray) -> tuple[float, np.ndarray]:
        wrapped = (angles_deg + 180.0) % 360.0 - 180.0
        inside = np.clip(wrapped, *limits_deg)
        return float(np.abs(inside - wrapped).sum()), inside

    _, best_deg = min(clipped(about), clipped(other), key=lambda pair: pair[0])
    return JointAngles.from_degrees(*best_deg.tolist())


def _check(session: Any, path: Path) -> None:
    """Raise unless a model is a learned start of this version, with its inputs and outputs."""
    said = session.get_modelmeta().custom_metadata_map
    for key, expected in start_metadata().items():
        if said.get(key) != expected:
            got = "nothing" if key not in said else f"'{clean(said[key])}'"
            what = (
                f"{key} '{expected}'"
                if key != "about"
                else "the inputs and outputs of this version"
            )
            fail(path, f"{_EXPECTED} with {what}", got)
    inputs, outputs = session.get_inputs(), session.get_outputs()
    shapes = [[node.shape[-1] for node in nodes] for nodes in (inputs, outputs)]
    if shapes != [[N_INPUTS], [sum(OUTPUTS.values())]]:
        fail(path, f"{_EXPECTED} with {N_INPUTS} inputs", f"inputs and outputs of {shapes}")

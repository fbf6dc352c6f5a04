"""Learn the joint angles of hands from their images: a start for `clradar.calibration.fit_hand`.

pip install 'clradar[dataset,learned]'; for kind in pose_letters pose_free; do
clradar dataset plans/$kind.toml -o $kind; done; python train_pose.py pose_letters pose_free
clradar fit-hand MEASURED --pose start.onnx -o fitted
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

try:
    from onnx.helper import set_model_props
    from skl2onnx import to_onnx
    from sklearn.decomposition import PCA
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF
    from sklearn.pipeline import make_pipeline
except ImportError as error:
    sys.exit(f"train_pose.py: needs pip install 'clradar[dataset,learned]' ({error})")

from clradar.calibration.hand_fit.learned_start import prediction_of, samples_of, start_metadata

import clradar
from clradar.hand import LETTERS, HandPose, JointAngles, posed_skeleton

COMPONENTS, NOISE, WIDTH = 100, 0.1, 0.7  # width in units of the pictures' RMS deviation


def joints_mm(row: np.ndarray) -> np.ndarray:
    """Joints (25, 3) of the average hand with the predicted angles, its wrist straight."""
    angles = {**prediction_of(row).pose.joints, "wrist": JointAngles()}
    return 1e3 * posed_skeleton(HandPose("predicted", angles)).joints_m


def report(label: str, rows: np.ndarray, true: np.ndarray) -> None:
    """Print how far the tips of a row are from the true ones, and how many letters are right."""
    tips = [np.array([joints_mm(row)[4::5] for row in table]) for table in (rows, true)]
    middle, most = np.quantile(np.linalg.norm(tips[0] - tips[1], axis=-1), (0.5, 0.95))
    scores, right = (
        table[true[:, -len(LETTERS) :].any(axis=1), -len(LETTERS) :] for table in (rows, true)
    )
    share = np.mean(scores.argmax(axis=1) == right.argmax(axis=1)) if len(right) else np.nan
    print(f"  {label}: tips {middle:.1f} mm off, 95 % within {most:.1f}; letters {share:.3f} right")


def main(*folders: str) -> None:
    parts = [samples_of(clradar.open_dataset(folder)) for folder in folders or ["pose_letters"]]
    x, y, unseen = (np.concatenate(part) for part in zip(*parts, strict=True))
    known, count = ~unseen, np.count_nonzero(unseen)
    if count == 0 or len(x) - count < 3:
        sys.exit(f"{' '.join(folders)}: expected at least four samples of every pose, got {len(x)}")
    pca = PCA(min(COMPONENTS, len(x) - count - 1), random_state=0)
    width = WIDTH * np.sqrt((pca.fit_transform(x[known]) ** 2).sum(axis=1).mean())
    regression = GaussianProcessRegressor(RBF(width), alpha=NOISE, optimizer=None, normalize_y=True)
    model = make_pipeline(pca, regression).fit(x[known], y[known])
    print(f"{len(x) - count} samples learned, {count} unseen:")
    report("learned", model.predict(x[unseen]), y[unseen])
    report("always the mean", np.tile(y[known].mean(axis=0), (count, 1)), y[unseen])
    program = to_onnx(model, x[:1].astype(np.float32))
    set_model_props(program, start_metadata())
    Path("start.onnx").write_bytes(program.SerializeToString())


if __name__ == "__main__":
    main(*sys.argv[1:])

"""How well can a small classifier tell letters in radar images of hands that it was not taught on?

pip install xarray 'dask[array]' scikit-learn
clradar dataset plans/letters.toml -o letters --workers 2 && python train_letters.py letters
"""

from __future__ import annotations

import sys

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter, zoom
from sklearn.decomposition import PCA
from sklearn.metrics import ConfusionMatrixDisplay
from sklearn.pipeline import make_pipeline
from sklearn.svm import SVC

import clradar

RANGE_DB, DEPTH_M, PIXEL_MM = 25.0, 0.04, 6.0


def features(image: np.ndarray, depth_m: np.ndarray, step: float) -> np.ndarray:
    """Brightness and depth below the nearest point, both moved to the middle of the brightness."""
    bright = 1 + 20 * np.log10(np.maximum(image / image.max(), 1e-6)) / RANGE_DB
    bright = np.maximum(bright, 0)
    near = np.nan_to_num(np.maximum(1 - (depth_m - np.nanmin(depth_m)) / DEPTH_M, 0))
    at = [np.average(i, weights=bright**2) for i in np.indices(bright.shape)]
    shift = [n // 2 - round(a) for n, a in zip(bright.shape, at, strict=True)]
    both = [gaussian_filter(np.roll(part, shift, (0, 1)), 0.5 / step) for part in (bright, near)]
    return np.concatenate([zoom(part, step, order=1).ravel() for part in both])


def main(folder: str = "letters") -> None:
    data = clradar.open_dataset(folder)
    step = float(data.x_m[1] - data.x_m[0]) * 1e3 / PIXEL_MM
    images, depths_m, y = data.max_projection.values, data.depth_map.values, data.pose.values
    kept = data.sample.values // len(set(y)) % 4 == 3
    x = np.array([features(i, d, step) for i, d in zip(images, depths_m, strict=True)])
    # The mirror image of a right hand is a left hand with the same letter.
    mirrored = zip(images[..., ::-1], depths_m[..., ::-1], strict=True)
    x_mirrored = np.array([features(i, d, step) for i, d in mirrored])
    known = np.concatenate([x[~kept], x_mirrored[~kept]])
    model = make_pipeline(PCA(min(100, len(known) - 1), random_state=0), SVC(C=10))
    model.fit(known, np.tile(y[~kept], 2))
    found = model.predict(x[kept])
    print(f"right of {kept.sum()} unseen: {np.mean(found == y[kept]):.3f}")
    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots()
    ConfusionMatrixDisplay.from_predictions(y[kept], found, ax=axes, colorbar=False)
    figure.savefig("confusion.png", dpi=100)


if __name__ == "__main__":
    main(*sys.argv[1:])

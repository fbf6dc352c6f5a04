"""Accuracy and processor time of images of whole bodies, cluster by cluster and piece by piece.

    .venv/bin/python benchmarks/body_image.py [--ranges-m 0.8 1.7] [--clusters 0 13] [--step-mm 3]

The wall is 4 x 8 of the imager, 20 cm apart; the grid 1 x 2 x 0.3 m. Of each cluster and range the
image of one piece of the grid, of noise in all channels and of echoes all over the grid, beside the
exact sum in float64 at drawn voxels; RMS relative to the exact image's RMS over the same voxels.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
from fast_accuracy import N_VOXELS, QAR50, echoes, exact, noise

import clradar
from clradar import AntennaArray, Capture, VoxelGrid, Waveform
from clradar.imaging.fast import grid_pieces
from clradar.imaging.several_captures import mean_over_pairs

SWEEP = Waveform.sfcw(72e9, 82e9, 128)
X_M, Y_M = (np.linspace(-half, half, n) for half, n in ((0.3, 4), (0.7, 8)))
POINTS = 300


def cluster(number: int) -> AntennaArray:
    shift_m = [X_M[number % 4], Y_M[number // 4], 0.0]
    return AntennaArray(QAR50.tx_m + shift_m, QAR50.rx_m + shift_m)


def body_grid(z_m: float, step_m: float) -> VoxelGrid:
    counts = tuple(round(length / step_m) + 1 for length in (0.999, 1.998, 0.3))
    return VoxelGrid([-0.4995, -0.999, z_m], [step_m] * 3, counts)


def error_db(got: np.ndarray, want: np.ndarray) -> float:
    power = np.mean(np.abs(got - want) ** 2) / np.mean(np.abs(want) ** 2)
    return float(10 * math.log10(power))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ranges-m", type=float, nargs="+", default=[0.8, 1.7])
    parser.add_argument("--clusters", type=int, nargs="+", default=[0, 13])
    parser.add_argument("--step-mm", type=float, default=3.0)
    parser.add_argument("--piece", type=int, default=0)
    parser.add_argument("--tolerance-db", type=float, default=-50.0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    for z_m in arguments.ranges_m:
        grid = body_grid(z_m, arguments.step_mm / 1e3)
        piece = grid_pieces(grid)[arguments.piece].grid
        size_m = piece.spacing_m * (np.array(piece.counts) - 1)
        echoes_m = piece.origin_m + size_m * rng.random((POINTS, 3))
        # At drawn voxels, and at those nearest to echoes, where all the power is.
        at = [rng.integers(0, piece.counts, (N_VOXELS, 3)),
              np.round((echoes_m - piece.origin_m) / piece.spacing_m).astype(int)]  # fmt: skip
        for kind, make in (("noise", noise), ("echoes", echoes)):
            images, wants = [], []
            for number in arguments.clusters:
                capture: Capture = make(cluster(number), SWEEP, echoes_m, rng)
                start = time.process_time()
                image = clradar.backproject(
                    capture, piece, tolerance_db=arguments.tolerance_db, check_grid=False
                )
                took_s = time.process_time() - start
                wants.append([exact(capture, piece.origin_m + piece.spacing_m * a) for a in at])
                images.append((image.data, capture.data.size))
                errors = [
                    error_db(image.data[a[:, 2], a[:, 1], a[:, 0]], want)
                    for a, want in zip(at, wants[-1], strict=True)
                ]
                print(
                    f"z {z_m} m, cluster {number:2d}, {kind}: {errors[0]:.1f} dB, near echoes "
                    f"{errors[1]:.1f} dB, {took_s:.1f} s of processor time, "
                    f"{1e6 * took_s / image.data.size:.2f} us per voxel", flush=True,
                )  # fmt: skip
            mean = mean_over_pairs(iter(images), piece.shape)
            errors = [
                error_db(mean[a[:, 2], a[:, 1], a[:, 0]], np.mean(want, axis=0))
                for a, want in zip(at, zip(*wants, strict=True), strict=True)
            ]
            print(f"  their sum: {errors[0]:.1f} dB, near echoes {errors[1]:.1f} dB", flush=True)


if __name__ == "__main__":
    main()

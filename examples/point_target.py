"""The point spread function: its -3 dB widths against theory for the array and the bandwidth."""

from __future__ import annotations

import numpy as np

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S as C


def point_capture(point_m: np.ndarray) -> clradar.Capture:
    """The capture of one point: exp(-j 2 pi f d / c) for every pair, d its path length."""
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 128)
    to_tx = np.linalg.norm(array.tx_m - point_m, axis=1)
    to_rx = np.linalg.norm(array.rx_m - point_m, axis=1)
    cycles = (to_tx[:, None] + to_rx)[:, :, None] * (waveform.frequencies_hz / C)
    return clradar.Capture(np.exp(-2j * np.pi * cycles).astype(np.complex64), array, waveform)


def width_m(axis_m: np.ndarray, amplitude: np.ndarray) -> float:
    """The width of the main lobe at 1 / sqrt(2) of its peak, interpolated."""
    top, level = int(amplitude.argmax()), amplitude.max() / np.sqrt(2)
    left, right = top, top
    while amplitude[left] > level:
        left -= 1
    while amplitude[right] > level:
        right += 1
    low = np.interp(level, amplitude[left : left + 2], axis_m[left : left + 2])
    high = np.interp(-level, -amplitude[right - 1 : right + 1], axis_m[right - 1 : right + 1])
    return float(high - low)


def main(point_m: tuple[float, float, float] = (0.0, 0.0, 0.3)) -> None:
    capture = point_capture(np.array(point_m))
    # Along x the two columns of Tx give cos(u), the rows of Rx sin(u) / u, u = 2 pi a x / (lambda
    # R): together a sinc of twice the aperture. Along z it is the bandwidth.
    wavelength_m, half_m, bandwidth_hz = C / 77e9, 0.0705, 10e9
    lateral_m = 0.886 * wavelength_m * point_m[2] / (4 * half_m)
    theory_m = (lateral_m, lateral_m, 0.886 * C / (2 * bandwidth_hz))
    for i, name in enumerate("xyz"):
        extent = [(p, p) for p in point_m]
        extent[i] = (point_m[i] - 0.02, point_m[i] + 0.02)
        grid = clradar.VoxelGrid.from_extent(*extent, 0.25e-3)
        line = np.abs(clradar.backproject(capture, grid, method="exact").data).ravel()
        axis_m = (grid.x_m, grid.y_m, grid.z_m)[i]
        peak_mm, width_mm = 1e3 * axis_m[line.argmax()], 1e3 * width_m(axis_m, line)
        print(f"{name}: peak {peak_mm:.2f} mm, width {width_mm:.2f} mm, ", end="")
        print(f"far-field theory {1e3 * theory_m[i]:.2f} mm")


if __name__ == "__main__":
    main()

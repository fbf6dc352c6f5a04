"""Read another program's file through a layout, keep it as a native file, and form its image."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import clradar
from clradar.measurement_io import LayoutNeeded, open_capture, save_capture

LAYOUT = Path(__file__).parent / "layouts" / "split_parts.toml"


def write_recording(path: Path) -> None:
    """Write a file to read where there is none: a point at (20, -10, 250) mm, 24 x 20 antennas."""
    line = np.linspace(-70.0, 70.0, 24)
    tx_mm = np.stack([np.full(24, -72.0), line, np.zeros(24)], axis=1)
    rx_mm = np.stack([line[2:-2], np.full(20, 72.0), np.zeros(20)], axis=1)
    f_ghz = np.linspace(72.0, 82.0, 64)
    point_mm = np.array([20.0, -10.0, 250.0])
    segments_mm = [np.linalg.norm(side - point_mm, axis=1) for side in (tx_mm, rx_mm)]
    length_m = (segments_mm[0][:, np.newaxis] + segments_mm[1]) / 1e3
    signal = np.exp(-2j * np.pi * 1e9 * f_ghz[:, np.newaxis, np.newaxis] * length_m / 299_792_458)
    np.savez(
        path,
        s_real=signal.real.astype(np.float32),
        s_imag=signal.imag.astype(np.float32),
        f_ghz=f_ghz,
        tx_mm=tx_mm,
        rx_mm=rx_mm,
    )


def main(source: str = "lab.npz") -> None:
    if not Path(source).exists():
        write_recording(Path(source))
    try:
        open_capture(source)
    except LayoutNeeded as needed:
        print(needed.skeleton)  # where a new layout begins; this file's is already written

    capture = open_capture(source, layout=LAYOUT)
    save_capture("lab.h5", capture, force=True)
    grid = clradar.VoxelGrid.from_extent((-0.05, 0.05), (-0.05, 0.05), (0.22, 0.28), 2e-3)
    volume = clradar.backproject(capture, grid)
    z, y, x = np.unravel_index(np.abs(volume.data).argmax(), volume.data.shape)
    place_mm = [1e3 * axis[i] for axis, i in ((grid.x_m, x), (grid.y_m, y), (grid.z_m, z))]
    print("strongest: " + ", ".join(f"{value:.0f}" for value in place_mm) + " mm")


if __name__ == "__main__":
    main()

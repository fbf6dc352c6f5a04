"""Write cached products byte by byte from the description of the form, without measurement_io.

A scene is given in radar space (x to the right as the radar sees it, y up, z away, metres) as an
array [x, y, z] of amplitudes; each file follows the description of the format.
"""

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

DEPTH_CUT_DB = 15.0


@dataclass(frozen=True)
class RadarScene:
    """amplitude[x, y, z] on the axes of radar space, each ascending."""

    amplitude: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    z_m: np.ndarray

    def strongest(self) -> tuple[np.ndarray, np.ndarray]:
        """Return amplitude and depth [x, y] of the strongest voxel along z, NaN below -15 dB."""
        peak = self.amplitude.max(axis=2)
        depth = self.z_m[self.amplitude.argmax(axis=2)]
        return peak, np.where(peak >= peak.max() * 10 ** (-DEPTH_CUT_DB / 20), depth, np.nan)


def scene(targets: list[tuple[float, float, float, float]], counts=(31, 21, 9)) -> RadarScene:
    """Return blobs at (x, y, z) in metres of radar space, with their amplitude.

    The three axes differ in length, extent and centre, so that no two can be mistaken.
    """
    x = np.linspace(-0.10, 0.14, counts[0])
    y = np.linspace(-0.08, 0.05, counts[1])
    z = np.linspace(0.26, 0.34, counts[2])
    total = np.full(counts, 2.0)
    for tx, ty, tz, strength in targets:
        r2 = (x - tx)[:, None, None] ** 2 + (y - ty)[:, None] ** 2 + (z - tz) ** 2
        total += strength * np.exp(-r2 / 0.012**2)
    return RadarScene(total, x, y, z)


def image_rows(of_xy: np.ndarray) -> np.ndarray:
    """Return [row = y descending, column = x ascending] of an array [x, y]."""
    return of_xy.T[::-1]


def png(pixels: np.ndarray, bits: int = 16) -> bytes:
    """Return a PNG of grey pixels [row, column]."""
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels, f"<u{bits // 8}")).save(stream, "PNG")
    return stream.getvalue()


def png_pixels(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)), np.uint16)


def write_products(radar: Path, number: int, of: RadarScene) -> dict[str, Any]:
    """Write the four products of a frame and its entry of calibration.json; return the entry."""
    peak, depth = of.strongest()
    rows_mm = np.nan_to_num(np.round(image_rows(depth) * 1000))
    _put(radar / "depth" / f"{number:06d}.png", png(rows_mm.astype(int)))
    _put(radar / "maxproj" / f"{number:06d}.png", png(image_rows(peak).astype(int)))

    for product in ("volume", "xyz"):  # which nothing reads
        _put(radar / product / f"{number:06d}.ply", b"ply\n")
    low, high = float(of.amplitude.min()), float(of.amplitude.max())
    n_x, n_y, n_z = of.amplitude.shape
    entry = {
        "volume": {
            "bb_min": [float(a[0]) for a in (of.x_m, of.y_m, of.z_m)],
            "bb_max": [float(a[-1]) for a in (of.x_m, of.y_m, of.z_m)],
            "grid_size": [n_x, n_y, n_z],
            "min_abs": low,
            "max_abs": high,
            "min_amplitude": low,
            "max_amplitude": high,
        },
        "amplitude": {
            "amplitude_filter_kernel_size": 1,
            "amplitude_filter_threshold_dB": DEPTH_CUT_DB,
        },
        "depth": {"intrinsics": intrinsics(of)},
    }
    put_entry(radar, number, entry)
    return entry


def intrinsics(of: RadarScene) -> list[list[float]]:
    """Return the matrix from (x, y, z, 1) in metres to (column, row, millimetres, 1)."""
    dx, dy = of.x_m[1] - of.x_m[0], of.y_m[1] - of.y_m[0]
    return [
        [float(1 / dx), 0.0, 0.0, float(-of.x_m[0] / dx)],
        [0.0, float(-1 / dy), 0.0, float(of.y_m[-1] / dy)],
        [0.0, 0.0, 1000.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]


def put_entry(radar: Path, number: int, entry: Any) -> None:
    path = radar / "calibration.json"
    content = json.loads(path.read_text()) if path.exists() else {}
    content[f"{number:06d}"] = entry
    _put(path, json.dumps(content).encode())


def _put(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)

"""Write recordings byte by byte from the description of the form, without measurement_io.

The pickles come from the standard library and are then rewritten opcode by opcode, so that both
spellings of numpy's modules (before and since numpy 2) exist whichever numpy runs the tests.
"""

import io
import json
import pickle
import pickletools
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

PROTOCOLS = (2, 3, 4, 5)
FRAME_INTERVAL_US = 125_000
SPELLINGS = ("numpy.core", "numpy._core")


def random_frame(n_freq: int = 2, channels: int = 96, seed: int = 0) -> dict[str, Any]:
    """Return the dictionary of a frame: xr [rx, tx, freq] of normal deviates, fvec 72 to 82 GHz."""
    rng = np.random.default_rng(seed)
    shape = (channels, channels, n_freq)
    xr = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
    return {
        "xr": xr,
        "fvec": np.linspace(72e9, 82e9, n_freq),
        "number_of_measurements": np.int64(3),
        "timestamp_us": np.array([1_700_000_000_000_123]),
    }


def expected_data(frame: dict[str, Any]) -> np.ndarray:
    """Return data[tx, rx, freq] of a frame, element by element order written out."""
    xr = frame["xr"]
    if xr.shape[0] == 96:
        xr = xr[1:-1, 1:-1]
    return np.stack([xr[:, tx, :] for tx in range(94)], axis=0)


def pickled(obj: Any, protocol: int = 4, spelling: str | None = None) -> bytes:
    """Return the pickle that `numpy.save` would put after the header of a 0-d object array."""
    holder = np.empty((), dtype=object)
    holder[()] = obj
    data = pickle.dumps(holder, protocol=protocol)
    return data if spelling is None else respelled(data, spelling)


def respelled(data: bytes, spelling: str) -> bytes:
    """Return the pickle with numpy's private modules named as that numpy names them."""
    out = io.BytesIO()
    operations = list(pickletools.genops(data))
    ends = [position for _, _, position in operations[1:]] + [len(data)]
    for (opcode, argument, start), end in zip(operations, ends, strict=True):
        if opcode.name == "FRAME":
            continue  # its length would no longer be right, and no reader needs it
        if opcode.name == "GLOBAL":
            module, name = argument.split(" ")
            out.write(f"c{_other_name(module, spelling)}\n{name}\n".encode())
        elif opcode.name == "SHORT_BINUNICODE" and argument.startswith("numpy."):
            text = _other_name(argument, spelling).encode()
            out.write(b"\x8c" + bytes([len(text)]) + text)
        else:
            out.write(data[start:end])
    return out.getvalue()


def _other_name(module: str, spelling: str) -> str:
    for known in SPELLINGS:
        if module.startswith(known + "."):
            return spelling + module[len(known) :]
    return module


def npy(pickle_bytes: bytes, descr: str = "|O", shape: str = "()") -> bytes:
    """Return an .npy file of version 1.0 with this pickle as its content."""
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    padding = -(len(header) + 11) % 64
    header += " " * padding + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + pickle_bytes


def put(path: Path, content: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def write_frame(path: Path, frame: Any, protocol: int = 4, spelling: str | None = None) -> Path:
    return put(path, npy(pickled(frame, protocol, spelling)))


def write_recording(
    distance: Path, n_frames: int = 2, n_freq: int = 2, name: str | None = None
) -> Path:
    """Write raw and emptyfiltered frames with seeds 0, 1, ... and 100, 101, ...; return radar_*.

    Both variants have the same time stamps, 125 ms apart.
    """
    radar = distance / (name or f"radar_72.0_82.0_{n_freq}")
    for i in range(n_frames):
        for suffix, seed in (("", i), ("_emptyfiltered", 100 + i)):
            frame = random_frame(n_freq, seed=seed)
            frame["number_of_measurements"] = n_frames
            frame["timestamp_us"] = frame["timestamp_us"] + i * FRAME_INTERVAL_US
            write_frame(radar / "calibrated_data" / f"{i:06d}{suffix}.npy", frame)
    (radar / "calibration.json").write_text(
        f'{{"frequency_low_ghz": 72.0, "frequency_high_ghz": 82.0, "frequency_points": {n_freq}}}'
    )
    return radar


# ---- what lies beside the radar folder


def rigid(turns_deg: tuple[float, float, float], shift: tuple[float, float, float]) -> np.ndarray:
    """Return a 4 x 4 matrix: rotations about x, then y, then z, then a shift."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", turns_deg, degrees=True).as_matrix()
    matrix[:3, 3] = shift
    return matrix


def write_json(path: Path, content: Any) -> Path:
    return put(path, json.dumps(content, indent=1, default=np.ndarray.tolist).encode())


def write_alignment(distance: Path, transforms: dict[str, Any]) -> Path:
    """Write alignment.json: row-major 4 x 4 matrices under "<a>2<b>"; what is no array as it is."""
    return write_json(distance / "alignment.json", transforms)


def write_mesh(distance: Path, name: str, vertices: np.ndarray, faces: np.ndarray) -> Path:
    """Write photogrammetry/<name>.obj as photogrammetry programs do: with texture and material."""
    lines = ["# metres", f"mtllib {name}.mtl", "usemtl skin"]
    lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in vertices]
    lines += ["vt 0.0 0.0", "vt 1.0 0.0", "vt 0.0 1.0"]
    lines += [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in faces]
    return put(distance / "photogrammetry" / f"{name}.obj", ("\n".join(lines) + "\n").encode())


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
    put(radar / "depth" / f"{number:06d}.png", png(rows_mm.astype(int)))
    put(radar / "maxproj" / f"{number:06d}.png", png(image_rows(peak).astype(int)))

    for product in ("volume", "xyz"):  # which nothing reads
        put(radar / product / f"{number:06d}.ply", b"ply\n")
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
    write_json(path, content)

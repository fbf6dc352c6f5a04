"""Write recorded frames byte by byte, without measurement_io: to test its reader.

The pickles come from the standard library and are then rewritten opcode by opcode, so that both
spellings of numpy's modules (before and since numpy 2) exist whichever numpy runs the tests.
"""

import io
import json
import pickle
import pickletools
import struct
from pathlib import Path
from typing import Any

import numpy as np
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


def write_frame(path: Path, frame: Any, protocol: int = 4, spelling: str | None = None) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(npy(pickled(frame, protocol, spelling)))
    return path


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
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1))
    return path


def write_alignment(distance: Path, transforms: dict[str, Any]) -> Path:
    """Write alignment.json: row-major 4 x 4 matrices under "<a>2<b>"; what is no array as it is."""
    rows = {
        key: [[float(v) for v in row] for row in value] if isinstance(value, np.ndarray) else value
        for key, value in transforms.items()
    }
    return write_json(distance / "alignment.json", rows)


def write_mesh(distance: Path, name: str, vertices: np.ndarray, faces: np.ndarray) -> Path:
    """Write photogrammetry/<name>.obj as photogrammetry programs do: with texture and material."""
    path = distance / "photogrammetry" / f"{name}.obj"
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["# metres", f"mtllib {name}.mtl", "usemtl skin"]
    lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in vertices]
    lines += ["vt 0.0 0.0", "vt 1.0 0.0", "vt 0.0 1.0"]
    lines += [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")
    return path

"""Write recorded frames byte by byte, without measurement_io: what its reader is held against.

The pickles come from the standard library and are then rewritten opcode by opcode, so that both
spellings of numpy's modules (before and since numpy 2) exist whichever numpy runs the tests.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import struct
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

PROTOCOLS = (2, 3, 4, 5)
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


class _Python2Pickler(pickle._Pickler):  # type: ignore[name-defined, misc]
    """Writes strings and bytes alike as Python 2 did: one kind of byte string."""

    dispatch: ClassVar = dict(pickle._Pickler.dispatch)  # type: ignore[attr-defined]

    def _save_string(self, obj: str | bytes) -> None:
        raw = obj.encode("latin1") if isinstance(obj, str) else obj
        self.write(b"T" + struct.pack("<i", len(raw)) + raw)
        self.memoize(obj)

    dispatch[str] = _save_string
    dispatch[bytes] = _save_string


def pickled_by_python_2(obj: Any) -> bytes:
    """Return the frame's pickle as Python 2 with an old numpy wrote it (protocol 2)."""
    holder = np.empty((), dtype=object)
    holder[()] = obj
    stream = io.BytesIO()
    _Python2Pickler(stream, protocol=2).dump(holder)
    return respelled(stream.getvalue(), "numpy.core")


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
    """Write raw and emptyfiltered frames with seeds 0, 1, ... and 100, 101, ...; return radar_*."""
    radar = distance / (name or f"radar_72.0_82.0_{n_freq}")
    for i in range(n_frames):
        for suffix, seed in (("", i), ("_emptyfiltered", 100 + i)):
            frame = random_frame(n_freq, seed=seed)
            frame["number_of_measurements"] = n_frames
            write_frame(radar / "calibrated_data" / f"{i:06d}{suffix}.npy", frame)
    (radar / "calibration.json").write_text(
        f'{{"frequency_low_ghz": 72.0, "frequency_high_ghz": 82.0, "frequency_points": {n_freq}}}'
    )
    return radar

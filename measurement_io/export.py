"""Captures, volumes and depth maps in files that other programs open."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import OutputError
from clradar.files.atomic import refuse_existing, replacing
from clradar.files.failures import fail, shown
from clradar.files.json_file import to_json
from clradar.model import Capture, DepthMap, Volume, checks

Exported = Capture | Volume | DepthMap
_NOUNS = {Capture: "a capture", Volume: "a volume", DepthMap: "a depth map"}

MAT_BYTES = 2**31 - 2**16  # of one array: more does not fit the 32-bit sizes of MATLAB v5
STEEPEST = 3.0
"""Neighbours of a surface are joined where their depths differ by at most this many pixels: beyond
some 70 degrees there is an edge with another surface behind it."""

_INSTEAD = {
    Capture: "form its image first (backproject, `clradar image`)",
    Volume: "take its depth map (Volume.depth_map, `clradar export --depth-map`)",
    DepthMap: "take the volume that it is made of",
}


def export_file(path: str | os.PathLike[str], record: Exported, *, force: bool = False) -> None:
    """Write a capture, a volume or a depth map for another program, whole or not at all.

    The ending of the name decides: .vti holds a volume, .ply a depth map, .mat (MATLAB v5) and .npz
    anything; docs/files.md has what is in each. Antenna patterns and the scale of a volume are left
    out. `force` replaces an existing file.

    Examples
    --------
    >>> grid = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (3, 2, 4))
    >>> measurement_io.export_file("volume.npz", clradar.Volume(np.ones(grid.shape), grid))
    >>> with np.load("volume.npz") as file:
    ...     file["data"].shape, file["z_m"].tolist()
    ((4, 2, 3), [0.3, 0.301, 0.302, 0.303])
    """
    target = Path(path)
    suffix, noun = target.suffix.lower(), _NOUNS.get(type(record))
    if suffix not in FORMATS:
        endings = ", ".join(FORMATS)
        raise OutputError(
            f"{shown(target)}: expected a name that ends in {endings}, got '{target.suffix}'"
        )
    if noun is None:
        got = type(record).__name__
        checks.fail("export_file: record", "a Capture, a Volume or a DepthMap", got)
    write, *kinds = FORMATS[suffix]
    if type(record) not in kinds:
        held = " or ".join(_NOUNS[kind] for kind in kinds)
        raise OutputError(
            f"{shown(target)}: a {suffix} file holds {held}, got {noun}; {_INSTEAD[type(record)]}"
        )
    refuse_existing(target, force=force)
    if suffix == ".mat":
        largest = max(np.asarray(value).nbytes for value in arrays_of(record).values())
        if largest > MAT_BYTES:
            fail(target, f"at most {MAT_BYTES} bytes in an array of a .mat file",
                 f"{largest}; a .npz file holds more", error=OutputError)  # fmt: skip
    with replacing(target, force=force) as temporary:
        write(temporary, record)


def arrays_of(record: Exported) -> dict[str, Any]:
    """Return arrays and texts under the names that they have in a native file."""
    if isinstance(record, Capture):
        return {
            "data": record.data,
            "tx_m": record.array.tx_m,
            "rx_m": record.array.rx_m,
            "frequency_hz": record.waveform.frequencies_hz,
            "array_name": record.array.name,
            "axes": "tx, rx, frequency_hz",
            "provenance": to_json("Capture.meta", record.meta),
        }
    if isinstance(record, Volume):
        axes = {f"{name}_m": getattr(record.grid, f"{name}_m") for name in "xyz"}
        text = to_json("Volume.meta", record.meta)
        return {"data": record.data, **axes, "axes": "z_m, y_m, x_m", "provenance": text}
    return {
        "depth_m": record.depth_m,
        "amplitude": record.amplitude,
        "x_m": record.x_m,
        "y_m": record.y_m,
        "axes": "y_m, x_m",
        "dynamic_range_db": record.dynamic_range_db,
    }


def _write_npz(path: Path, record: Exported) -> None:
    """Write an .npz file, not compressed; texts are 0-d arrays."""
    with open(path, "xb") as file:
        np.savez(file, **arrays_of(record))


def _write_mat(path: Path, record: Exported) -> None:
    """Write a MATLAB v5 file; an axis is a column."""
    from scipy.io import savemat

    with open(path, "xb") as file:
        savemat(file, arrays_of(record), do_compression=True, oned_as="column")


# ---- volumes as VTK image data (docs.vtk.org): XML, then raw arrays, each after its size

_VTI = """<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}" Direction="{axes}">
<Piece Extent="{extent}">
<PointData Scalars="amplitude">
<DataArray type="Float32" Name="amplitude" format="appended" offset="0"/>
<DataArray type="Float32" Name="image" {parts} format="appended" offset="{second}"/>
</PointData>
</Piece>
</ImageData>
<AppendedData encoding="raw">
   _"""


def _write_vti(path: Path, volume: Volume) -> None:
    """Write the points `amplitude` and `image` (real, imaginary), x fastest, in metres."""
    grid = volume.grid
    with np.errstate(over="ignore"):
        amplitude = np.abs(volume.data)
    arrays = [amplitude.astype("<f4", copy=False), volume.data.astype("<c8", copy=False)]
    header = _VTI.format(
        extent=" ".join(f"0 {n - 1}" for n in grid.counts),
        origin=" ".join(repr(float(v)) for v in grid.origin_m),
        spacing=" ".join(repr(float(v)) for v in grid.spacing_m),
        axes="1 0 0 0 1 0 0 0 1",
        parts='NumberOfComponents="2" ComponentName0="real" ComponentName1="imaginary"',
        second=8 + arrays[0].nbytes,
    )
    with open(path, "xb") as file:
        file.write(header.encode("ascii"))
        for array in arrays:
            file.write(np.uint64(array.nbytes).astype("<u8").tobytes())
            file.write(np.ascontiguousarray(array).data)
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


# ---- depth maps as surfaces


def _write_ply(path: Path, depth: DepthMap) -> None:
    """Write the pixels that have a depth as vertices, and triangles that face the radar."""
    import trimesh

    points_m = depth.points_m()
    if not len(points_m):
        checks.fail("export_file: record", "a depth map with a depth, for a .ply file", "none")
    amplitude = depth.amplitude[depth.mask]
    level_db = 20 * np.log10(amplitude / amplitude.max())
    grey = np.round(255 * np.clip(1 + level_db / depth.dynamic_range_db, 0, 1)).astype(np.uint8)
    mesh = trimesh.Trimesh(
        points_m, _triangles(depth), process=False, vertex_colors=np.stack([grey] * 3, axis=1),
        vertex_attributes={"amplitude": amplitude.astype(np.float32)},
    )  # fmt: skip
    path.write_bytes(mesh.export(file_type="ply", vertex_normal=False))


def _triangles(depth: DepthMap) -> np.ndarray:
    """Return triangles towards the radar between neighbouring pixels, (n, 3) rows of `points_m`."""
    number = np.full(depth.mask.shape, -1)
    number[depth.mask] = np.arange(depth.mask.sum())
    corners = [number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]]
    squares = np.stack(corners, axis=-1).reshape(-1, 4)
    triangles = np.concatenate([squares[:, [0, 1, 2]], squares[:, [2, 1, 3]]])
    triangles = triangles[(triangles >= 0).all(axis=1)]
    pixel_m = max(np.diff(axis).max(initial=0.0) for axis in (depth.x_m, depth.y_m))
    heights_m: np.ndarray = np.ptp(depth.depth_m[depth.mask][triangles], axis=1)
    return triangles[heights_m <= STEEPEST * pixel_m]


FORMATS: dict[str, Any] = {
    ".vti": (_write_vti, Volume),
    ".ply": (_write_ply, DepthMap),
    ".mat": (_write_mat, *_NOUNS),
    ".npz": (_write_npz, *_NOUNS),
}
"""Ending of a name -> what writes such a file, and what it can hold."""

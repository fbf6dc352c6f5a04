"""Volumes as VTK image data, which ParaView opens.

VTK file formats, docs.vtk.org, "ImageData": XML, then the arrays as raw bytes, each after its size.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clradar.model import Volume

_HEADER = """<?xml version="1.0"?>
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
_PARTS = 'NumberOfComponents="2" ComponentName0="real" ComponentName1="imaginary"'
_END = b"\n</AppendedData>\n</VTKFile>\n"


def write_vti(path: Path, volume: Volume) -> None:
    """Write the points `amplitude` and `image` (real, imaginary), x fastest, in metres."""
    grid = volume.grid
    with np.errstate(over="ignore"):
        amplitude = np.abs(volume.data)
    arrays = [amplitude.astype("<f4", copy=False), volume.data.astype("<c8", copy=False)]
    header = _HEADER.format(
        extent=" ".join(f"0 {n - 1}" for n in grid.counts),
        origin=" ".join(repr(float(v)) for v in grid.origin_m),
        spacing=" ".join(repr(float(v)) for v in grid.spacing_m),
        axes="1 0 0 0 1 0 0 0 1",
        parts=_PARTS,
        second=8 + arrays[0].nbytes,
    )
    with open(path, "xb") as file:
        file.write(header.encode("ascii"))
        for array in arrays:
            file.write(np.uint64(array.nbytes).astype("<u8").tobytes())
            file.write(np.ascontiguousarray(array).data)
        file.write(_END)

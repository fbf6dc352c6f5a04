"""Read named parts of an HDF5 file that may be damaged or hostile.

HDF5 can point outside the file (external links, external storage, virtual datasets), ask for
memory that the file does not back (fill values, filters that inflate) and load filter plug-ins.
Nothing of that occurs in a native file, so each is looked for before the data is touched. What the
library itself does wrong on damaged files is why all this runs in a confined process.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from clradar.files.confined.process import forbid_opening
from clradar.files.failures import clean, fail, reading, regular_file_size
from clradar.files.limits import MAX_CHUNK_BYTES, MAX_JSON_BYTES

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
SHUFFLE, FLETCHER32, DEFLATE, LZF = 2, 3, 1, 32000
"""Numbers of the filters: those of the HDF5 library, and the one that h5py brings along."""

_FILTER_NAMES = {SHUFFLE: "shuffle", FLETCHER32: "Fletcher-32", DEFLATE: "gzip", LZF: "LZF"}
CHECKING_FILTERS = (SHUFFLE, FLETCHER32)  # filters that neither shrink nor inflate
_WHOLE: Mapping[int, int] = {}

Value = TypeVar("Value", str, int)


@contextmanager
def opened(path: Path, expected: str) -> Iterator[Any]:
    """Open an HDF5 file for reading; whatever happens inside ends in a `MeasurementError`."""
    import h5py

    if regular_file_size(path, expected) == 0:
        fail(path, expected, "an empty file")
    with reading(path, expected), h5py.File(path, "r") as file:
        forbid_opening()
        sizes = file.id.get_create_plist().get_sizes()
        if tuple(sizes) != (8, 8):  # as h5py writes them
            fail(path, "an HDF5 file with 8-byte addresses and lengths", f"{sizes}")
        yield file


def group(path: Path, parent: Any, name: str) -> Any:
    """Return the group `name` of `parent`, reached by a hard link."""
    import h5py

    found = hard_linked(path, parent, name)
    if not isinstance(found, h5py.Group):
        fail(path, f"a group at {_place(parent, name)}", type(found).__name__)
    return found


def array(
    path: Path, parent: Any, name: str, dtype: Any, shape: tuple[int | None, ...]
) -> tuple[np.ndarray, bool]:
    """Return a dataset of a type, in any byte order, and shape (None: any length), read-only.

    And whether every chunk of it carries a Fletcher-32 checksum.
    """
    found = dataset(path, parent, name)
    place = _place(parent, name)
    dtype = np.dtype(dtype)
    stored = found.dtype
    if stored.newbyteorder("=") != dtype or stored.fields is not None:
        fail(path, f"{place} of type {dtype}", clean(stored))
    have = found.shape
    if (
        have is None
        or len(have) != len(shape)
        or any(n not in (None, m) for n, m in zip(shape, have, strict=True))
    ):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        fail(path, f"{place} of shape ({wanted})", f"shape {have}")
    nbytes = math.prod(have) * dtype.itemsize
    if nbytes == 0:
        fail(path, f"{place} with at least one element", f"shape {have}")
    size = path.stat().st_size
    if nbytes > size:
        fail(path, f"{place} to fit into the file's {size} bytes", f"shape {have}: {nbytes} bytes")
    filtered = check_stored(path, place, found)
    content = found[()].astype(dtype, copy=False)
    content.flags.writeable = False
    return content, found.fletcher32 and filtered


def dataset(path: Path, parent: Any, name: str, filters: Collection[int] = CHECKING_FILTERS) -> Any:
    """Return the dataset `name`, which lies in this file and needs no other than these filters."""
    import h5py

    place = _place(parent, name)
    found = hard_linked(path, parent, name)
    if not isinstance(found, h5py.Dataset):
        fail(path, f"a dataset at {place}", type(found).__name__)
    plan = found.id.get_create_plist()
    if plan.get_layout() == h5py.h5d.VIRTUAL or found.is_virtual:
        fail(path, f"{place} stored in the file", "a virtual dataset")
    if plan.get_external_count() or found.external:
        fail(path, f"{place} stored in the file", "external storage")
    for i in range(plan.get_nfilters()):
        code = plan.get_filter(i)[0]
        if code not in filters:
            allowed = ", ".join(_FILTER_NAMES[c] for c in filters)
            fail(path, f"{place} with no filters but {allowed}", f"filter {code}")
    return found


def attribute(path: Path, owner: Any, name: str, kind: type[Value]) -> Value:
    """Return an attribute that is one string, or one whole number."""
    import h5py

    place = f"{owner.name}@{name}"
    if name not in owner.attrs:
        fail(path, f"the attribute {place}", "none of that name")
    stored = owner.attrs.get_id(name)
    form, h5t = stored.get_type(), h5py.h5t
    known, noun = (
        (h5t.TypeStringID, "string") if kind is str else (h5t.TypeIntegerID, "whole number")
    )
    if not isinstance(form, known) or stored.shape != ():
        fail(path, f"the attribute {place} to be one {noun}", "another type")
    if form.get_size() > MAX_JSON_BYTES:
        fail(path, f"at most {MAX_JSON_BYTES} bytes of text", f"{form.get_size()}")
    value = owner.attrs[name]
    value = kind(value.decode("utf-8") if isinstance(value, bytes) else value)
    if isinstance(value, str) and len(value) > MAX_JSON_BYTES:
        fail(path, f"at most {MAX_JSON_BYTES} bytes of text", f"{len(value)}")
    return value


def hard_linked(path: Path, parent: Any, name: str) -> Any:
    """Return the object `name` of the group `parent`, if it lies in this file."""
    import h5py

    place = _place(parent, name)
    if name not in parent.keys():  # noqa: SIM118 - `in parent` would follow soft and external links
        fail(path, place, "nothing of that name")
    link = parent.get(name, getlink=True)
    if type(link) is not h5py.HardLink:
        fail(path, f"{place} in the file itself", f"a link of kind {type(link).__name__}")
    return parent[name]


def check_stored(path: Path, place: str, found: Any, pick: Mapping[int, int] = _WHOLE) -> bool:
    """Raise unless all that will be read is in the file: HDF5 would fill in the rest.

    Of the axes in `pick` one index is read. Return whether no chunk is stored without its filters.
    """
    if found.chunks is None:
        need, have = found.size * found.dtype.itemsize, found.id.get_storage_size()
        if have < need:
            fail(path, f"{need} bytes stored for {place}", f"{have}")
        return False
    chunk_bytes = math.prod(found.chunks) * found.dtype.itemsize
    if chunk_bytes > MAX_CHUNK_BYTES:
        expected = f"{place} in chunks of at most {MAX_CHUNK_BYTES} bytes"
        fail(path, expected, f"{chunk_bytes} bytes")
    rows = {axis: index // found.chunks[axis] * found.chunks[axis] for axis, index in pick.items()}
    per_axis = [-(-n // c) for n, c in zip(found.shape, found.chunks, strict=True)]
    need = math.prod(1 if axis in pick else n for axis, n in enumerate(per_axis))
    masks: list[int] = []

    def keep(chunk: Any) -> None:
        if all(chunk.chunk_offset[axis] == row for axis, row in rows.items()):
            masks.append(chunk.filter_mask)

    found.id.chunk_iter(keep)
    if len(masks) != need:
        fail(path, f"{need} chunks stored for {place}", f"{len(masks)}")
    return not any(masks)


def _place(parent: Any, name: str) -> str:
    return f"{str(parent.name).rstrip('/')}/{name}"

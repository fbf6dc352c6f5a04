"""Make Intel's CPU runtime visible where it is installed as a Python package.

The package (`pip install clradar[intel]`) puts its library into the environment, where the OpenCL
loader does not look. The loader reads one folder of `.icd` files, each naming a library, once per
process; `OCL_ICD_VENDORS` says which. It is pointed at a temporary folder with the system's
entries and one more while the platforms are asked for the first time, and then left as it was.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import pyopencl as cl

INTEL_PACKAGE, INTEL_LIBRARY = "intel-opencl-rt", "libintelocl.so"
SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
VARIABLES = ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH", "OCL_ICD_FILENAMES")
"""Who has set one of these has chosen the platforms; nothing is added."""

_asked = False


def platforms() -> list[Any]:
    """Return the OpenCL platforms of this machine, Intel's CPU runtime among them.

    Where something else in the process has asked pyopencl for platforms before, the loader's list
    is settled, and Intel's runtime is in it only if the system knows it.

    Raises
    ------
    pyopencl.Error
        There is none.
    """
    global _asked
    library = None if _asked else intel_library()
    _asked = True
    if library is None or any(os.environ.get(name) for name in VARIABLES):
        return list(cl.get_platforms())
    with _vendors(library):
        return list(cl.get_platforms())


def intel_library() -> Path | None:
    """Return the library of Intel's runtime in this environment, None if it is not installed."""
    try:
        files = distribution(INTEL_PACKAGE).files or []
    except PackageNotFoundError:
        return None
    for file in files:
        if file.name == INTEL_LIBRARY:
            found = Path(str(file.locate())).resolve()
            return found if found.is_file() else None
    return None


@contextmanager
def _vendors(library: Path) -> Iterator[None]:
    """Let the loader see the system's platforms and `library` while the block runs."""
    with tempfile.TemporaryDirectory(prefix="clradar-icd-") as name:
        folder = Path(name)
        known = sorted(SYSTEM_VENDORS.glob("*.icd")) if SYSTEM_VENDORS.is_dir() else []
        for entry in known:
            if entry.is_file() and INTEL_LIBRARY not in entry.read_text(errors="replace"):
                (folder / entry.name).symlink_to(entry)
        (folder / "clradar-intel.icd").write_text(f"{library}\n", encoding="utf-8")
        os.environ["OCL_ICD_VENDORS"] = str(folder)
        try:
            yield
        finally:
            del os.environ["OCL_ICD_VENDORS"]

"""Discovery of Intel's CPU runtime where it is installed as a Python package.

The package (`pip install intel-opencl-rt`; on Windows it comes with the install) puts its library
into the environment, where the OpenCL loader does not look. On Linux the loader reads one folder of
`.icd` files, each naming a library, once per process; `OCL_ICD_VENDORS` names it. While the
platforms are listed for the first time it names a temporary folder with the system's entries and
one more. On Windows `OCL_ICD_FILENAMES` names libraries beside those of the registry.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import pyopencl as cl

from clradar.errors import warn

INTEL_PACKAGE = "intel-opencl-rt"
INTEL_LIBRARY, INTEL_LIBRARY_WINDOWS = "libintelocl.so", "intelocl64.dll"
SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
VARIABLES = ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH", "OCL_ICD_FILENAMES")
"""Where one of these is set, the user has chosen the platforms, and nothing is added."""

_listed = False


def platforms() -> list[Any]:
    """The OpenCL platforms of this machine, with Intel's CPU runtime.

    Where other code of the process has listed platforms before, the loader's list is fixed, and
    Intel's runtime is in it only if the system has it.
    """
    global _listed
    if not _listed:
        _provide_cache()
    library = None if _listed else intel_library()
    _listed = True
    if library is None or any(os.environ.get(name) for name in VARIABLES):
        return list(cl.get_platforms())
    with _vendors(library):
        return list(cl.get_platforms())


def _provide_cache() -> None:
    """Give kernels a folder where the user's cannot be written: else PoCL has no device."""
    home = os.environ.get("HOME")
    if os.name != "posix" or not home:
        return
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path(home, ".cache"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return
    except OSError as error:
        own = tempfile.mkdtemp(prefix="clradar-cache-")
        atexit.register(shutil.rmtree, own, ignore_errors=True)
        os.environ["XDG_CACHE_HOME"] = own
        warn(
            f"{folder} cannot be written ({error.strerror}): kernels are built anew in every "
            "process; set XDG_CACHE_HOME to a folder that can"
        )


def intel_library() -> Path | None:
    """The library of Intel's runtime in this environment, None if it is not installed."""
    try:
        files = distribution(INTEL_PACKAGE).files or []
    except PackageNotFoundError:
        return None
    named = [file for file in files if file.name in (INTEL_LIBRARY, INTEL_LIBRARY_WINDOWS)]
    found = [Path(str(file.locate())).resolve() for file in named[:1]]
    return next(filter(Path.is_file, found), None)


@contextmanager
def _vendors(library: Path) -> Iterator[None]:
    """Show the loader the system's platforms and `library` while the block runs."""
    with tempfile.TemporaryDirectory(prefix="clradar-icd-") as folder:
        variable, value = "OCL_ICD_VENDORS", folder
        if library.suffix == ".dll":
            variable, value = "OCL_ICD_FILENAMES", str(library)
            # It finds the libraries that it needs beside it, some of them when it is used.
            os.environ["PATH"] = f"{library.parent}{os.pathsep}{os.environ.get('PATH', '')}"
        else:
            for entry in SYSTEM_VENDORS.glob("*.icd"):
                if entry.is_file() and INTEL_LIBRARY not in entry.read_text(errors="replace"):
                    Path(folder, entry.name).symlink_to(entry)
            Path(folder, "clradar-intel.icd").write_text(f"{library}\n", encoding="utf-8")
        os.environ[variable] = value
        try:
            yield
        finally:
            del os.environ[variable]

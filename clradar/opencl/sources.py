"""Kernel sources with their includes expanded.

They are expanded here rather than by the driver, so that a path with blanks in it works with every
driver and the text that is compiled is the text that is cached.
"""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import pyopencl

from clradar.errors import DeviceError

_INCLUDE = re.compile(r'^\s*#\s*include\s*["<]([^">]+)[">]', re.MULTILINE)

_PYOPENCL = Path(pyopencl.__file__).parent / "cl"  # the Random123 headers that pyopencl ships


@lru_cache(maxsize=1)
def kernel_folder() -> Path:
    """Folder of the OpenCL sources: in an installed wheel, or beside the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "kernels", package.parent / "kernels"):
        if (folder / "trace.cl").is_file():
            return folder
    raise DeviceError(
        f"expected the OpenCL kernels in {package / 'kernels'} or {package.parent / 'kernels'}, "
        f"found none; reinstall clradar"
    )


@lru_cache(maxsize=64)
def source(name: str) -> str:
    """Text of kernel file `name` with each include expanded at most once."""
    return _expand(kernel_folder() / name, set())


def _expand(path: Path, done: set[Path]) -> str:
    if path in done:
        return ""
    done.add(path)
    text = path.read_text(encoding="utf-8")
    pieces, at = [], 0
    for match in _INCLUDE.finditer(text):
        places = (folder / match[1] for folder in (kernel_folder(), path.parent, _PYOPENCL))
        target = next(filter(Path.is_file, places), None)
        if target is None:
            continue  # C++ headers in branches that OpenCL never takes
        line = text.count("\n", 0, match.end()) + 1
        pieces.append(text[at : match.start()])
        pieces.append(_expand(target, done))
        # The next line of this file keeps its number in the compiler's messages.
        pieces.append(f'\n#line {line} "{path.name}"')
        at = match.end()
    pieces.append(text[at:])
    return f'#line 1 "{path.name}"\n' + "".join(pieces)

"""Read a rigged hand in a confined process; the content of its file decides the format."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from clradar.errors import RigError, warn
from clradar.files.failures import fail, reading, regular_file_size
from clradar.files.limits import MAX_RIG_ANSWER_BYTES
from clradar.files.meshes.gltf_document import GLB_MAGIC
from clradar.files.meshes.reading import run_confined
from clradar.model import checks
from clradar.rigs.anatomy import UNITS_M
from clradar.rigs.mano import plain_mano
from clradar.rigs.rig import Rig

# White space of JSON, and the mark that some editors put before a text in UTF-8.
_BLANKS = b"\xef\xbb\xbf \t\r\n"

EXPECTED = "a rigged hand: skinned glTF (.glb, .gltf) or MANO (.pkl, .npz)"


def read_rig(
    path: str | os.PathLike[str],
    *,
    mapping: str | os.PathLike[str] | Mapping[str, str | int] | None = None,
    unit: str | float | None = None,
    handedness: str | None = None,
    betas: Sequence[float] | None = None,
) -> Rig:
    """Return the rigged hand of a file; docs/rigs.md has formats and checks.

    Parameters
    ----------
    path : path-like
        Skinned glTF 2.0 (`.glb`, `.gltf`) or a MANO model (`.pkl`, `.npz`); the content decides.
    mapping : path-like or mapping, optional
        The node of each joint, for glTF files whose joints have no WebXR names: a TOML file with a
        table ``[joints]``, or WebXR name -> name or number of a node.
    unit : "m", "cm", "mm", "inch", or a number, metres, optional
        The file's unit of length, metres by default.
    handedness : "right" or "left", optional
        Of the hand, or of the one to read of two. By default from the names of joints and file,
        else right.
    betas : sequence of float, optional
        Shape of a MANO hand; the remaining ones are 0.

    Examples
    --------
    >>> rig = clradar.rigs.read_rig("MANO_RIGHT.npz", unit="mm")
    >>> rig.handedness, rig.unit_m
    ('right', 0.001)
    """
    file = Path(path)
    if handedness is not None:
        checks.one_of("handedness", handedness, ("right", "left"))
    if isinstance(unit, str):
        unit = UNITS_M[checks.one_of("unit", unit, tuple(UNITS_M))]
    unit_m = 1.0 if unit is None else checks.positive("unit", unit)
    regular_file_size(file, EXPECTED, error=RigError)
    with reading(file, EXPECTED, error=RigError), open(file, "rb") as opened:
        start = opened.read(64)
    needed = ("clradar.rigs.anatomy:reference_hand",)  # which reads the poses of the package
    read = partial(run_confined, expected=EXPECTED, error=RigError, most_bytes=MAX_RIG_ANSWER_BYTES)
    # Pickles of protocol 2 and later begin with a byte of their own; earlier ones with any opcode.
    if start.startswith((b"PK\x03\x04", b"\x80")) or file.suffix.lower() in (".pkl", ".pickle"):
        if mapping is not None:
            checks.fail("mapping", "none for a MANO model, whose joints are known", "one")
        given = [] if betas is None else betas
        amounts = checks.read_only("betas", given, np.float64, (None,), allow_empty=True).tolist()
        return Rig.of_plain(read(plain_mano, file, amounts, unit_m, handedness, modules=needed))
    if betas is not None:
        checks.fail("betas", "a MANO model (.pkl, .npz) for them", f"{file.name}")
    if not start.startswith(GLB_MAGIC) and start.lstrip(_BLANKS)[:1] != b"{":
        fail(file, EXPECTED, "something else", error=RigError)
    from clradar.rigs.gltf import nodes_of, plain_gltf

    nodes = None if mapping is None else nodes_of(mapping, file)
    rig = Rig.of_plain(read(plain_gltf, file, nodes, unit_m, handedness, modules=needed))
    if rig.ignored:
        names = ", ".join(f"'{name}'" for name in rig.ignored)
        warn(f"{file}: the hand does not move these meshes, which are left out: {names}")
    return rig

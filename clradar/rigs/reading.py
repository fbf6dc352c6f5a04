"""Read a rigged hand; the content of its file decides the format."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from clradar.model import checks
from clradar.rigs.anatomy import UNITS_M
from clradar.rigs.failures import fail, file_bytes
from clradar.rigs.gltf_file import GLB_MAGIC
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
    """Return the rigged hand of a file.

    Parameters
    ----------
    path : path-like
        Skinned glTF 2.0 (`.glb`, or `.gltf` with its buffers) or a MANO model (`.pkl`, `.npz`); the
        content decides which. No code of a pickle is run.
    mapping : path-like or mapping, optional
        The node of each joint, for glTF files whose joints have no WebXR names: a TOML file with a
        table ``[joints]``, or WebXR name -> name or number of a node.
    unit : "m", "cm", "mm", "inch", or a number, metres, optional
        The file's unit of length. By default estimated from the hand's size (`UNITS_M`, `REACH_M`).
    handedness : "right" or "left", optional
        Of the hand, or of the one to read of two. By default from names and joint positions.
    betas : sequence of float, optional
        Shape of a MANO hand, at most as many as the model has; the remaining ones are 0.

    Returns
    -------
    Rig

    Raises
    ------
    RigError
        The file is damaged or contains no such hand.
    ModelError
        An argument is invalid.

    Examples
    --------
    A hand of three triangles in the format of MANO: every vertex is a joint.

    >>> import numpy as np
    >>> from clradar.hand import HandPose, posed_skeleton
    >>> from clradar.rigs import read_rig
    >>> from clradar.rigs.mano import MANO_JOINTS, PARENTS
    >>> np.savez(
    ...     "MANO_RIGHT.npz",
    ...     v_template=1e3 * posed_skeleton(HandPose("rest")).joints_m[list(MANO_JOINTS)],
    ...     shapedirs=np.zeros((16, 3, 1)), posedirs=np.zeros((16, 3, 135)),
    ...     J_regressor=np.eye(16), weights=np.eye(16), f=[[1, 4, 7], [2, 5, 8], [3, 6, 9]],
    ...     kintree_table=[PARENTS, range(16)],
    ... )
    >>> rig = read_rig("MANO_RIGHT.npz")
    >>> rig.handedness, rig.unit_m
    ('right', 0.001)
    """
    file = Path(path)
    if handedness is not None:
        checks.one_of("handedness", handedness, ("right", "left"))
    if isinstance(unit, str):
        checks.one_of("unit", unit, tuple(UNITS_M))
    elif unit is not None:
        unit = checks.positive("unit", unit)
    content = file_bytes(file, EXPECTED)
    if content.startswith(b"PK\x03\x04") or _is_pickle(file, content):
        from clradar.rigs.mano import mano_rig

        if mapping is not None:
            checks.fail("mapping", "none for a MANO model, whose joints are known", "one")
        return mano_rig(file, content, betas, unit, handedness)
    if betas is not None:
        checks.fail("betas", "a MANO model (.pkl, .npz) for them", f"{file.name}")
    if not content.startswith(GLB_MAGIC) and content[:64].lstrip(_BLANKS)[:1] != b"{":
        fail(file, EXPECTED, "something else")
    from clradar.rigs.gltf_rig import gltf_rig
    from clradar.rigs.names import read_mapping

    name = "the mapping"
    if mapping is not None and not isinstance(mapping, Mapping):
        name = Path(mapping).name
        mapping = read_mapping(Path(mapping))
    return gltf_rig(file, content, mapping, name, unit, handedness)


def _is_pickle(file: Path, content: bytes) -> bool:
    # Protocol 2 and later begin with a byte of their own; earlier ones with any opcode.
    return content.startswith(b"\x80") or file.suffix.lower() in (".pkl", ".pickle")

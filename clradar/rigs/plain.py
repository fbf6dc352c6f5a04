"""Rigs as plain values, as the process that reads them can send them."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from clradar.errors import ModelError
from clradar.files.confined.process import forbid_opening
from clradar.hand import pose_by_name
from clradar.rigs.failures import file_bytes
from clradar.rigs.gltf_rig import gltf_rig
from clradar.rigs.mano import mano_rig
from clradar.rigs.rig import Influences, PoseBlend, Rig


def plain_gltf(
    path: Path,
    mapping: dict[str, str | int] | None,
    mapping_name: str,
    unit: str | float | None,
    handedness: str | None,
) -> dict[str, Any]:
    """Return the rig of a glTF file; called in the confined process."""
    pose_by_name("flat")  # rigs need it; once the file is read, no other can be opened
    content = file_bytes(path, "a glTF file")
    return _plain(gltf_rig(path, content, mapping, mapping_name, unit, handedness))


def plain_mano(
    path: Path, betas: list[float], unit: str | float | None, handedness: str | None
) -> dict[str, Any]:
    """Return the rig of a MANO model, or what is wrong with `betas`; in the confined process."""
    pose_by_name("flat")  # as above
    content = file_bytes(path, "a MANO model")
    forbid_opening()
    try:
        return _plain(mano_rig(path, content, betas, unit, handedness))
    except ModelError as error:
        return {"argument": str(error)}


def _plain(rig: Rig) -> dict[str, Any]:
    found = _fields(rig)
    found["influences"] = _fields(rig.influences)
    found["blend"] = None if rig.blend is None else _fields(rig.blend)
    return found


def _fields(record: Any) -> dict[str, Any]:
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {name: list(v) if isinstance(v, tuple) else v for name, v in values.items()}


def rig_of_plain(found: dict[str, Any]) -> Rig:
    """Return the rig that `plain_gltf` or `plain_mano` found."""
    if "argument" in found:
        raise ModelError(found["argument"])
    blend = found["blend"]
    if blend is not None:
        blend = PoseBlend(**blend | {"joints": tuple(blend["joints"])})
    influences = Influences(**found["influences"])
    ignored = tuple(found["ignored"])
    return Rig(**found | {"influences": influences, "blend": blend, "ignored": ignored})

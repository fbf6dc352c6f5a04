"""A plan as a JSON value in the language of plan files, with nothing left out."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

from clradar.dataset.plan.draws import Draw
from clradar.dataset.plan.hand_json import pose_record, shape_record
from clradar.dataset.plan.plan import Alpha, Plan, digest
from clradar.hand import HandPose, HandShape


def plan_record(plan: Plan) -> dict[str, Any]:
    """Return a plan so that `plan_from` gives it back, to the last bit.

    Poses are written out with their angles: the record does not change when the poses of the
    package or the pose files do.
    """
    record = _plain(plan)
    del record["folder"]
    poses = record["poses"]
    poses["resolved"] = poses.pop("poses", [])
    if plan.poses.kind != "interpolation":
        del poses["share"]
    return record


def plan_digest(plan: Plan) -> str:
    """Return the SHA-256 that tells plans apart."""
    return digest(plan_record(plan))


def _plain(value: Any) -> Any:
    if isinstance(value, Draw):
        return value.to_plain()
    if isinstance(value, HandPose):
        return pose_record(value)
    if isinstance(value, HandShape):
        return shape_record(value)
    if isinstance(value, Alpha):
        return {
            name: _plain(draw) for name, draw in {**value.parts, "others": value.others}.items()
        }
    if is_dataclass(value):
        pairs = ((f.name, getattr(value, f.name)) for f in fields(value))
        return {name: _plain(item) for name, item in pairs if item not in (None, ())}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value

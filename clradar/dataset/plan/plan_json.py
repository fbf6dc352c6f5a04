"""A plan as a JSON value in the vocabulary of plan files, every key written out."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass
from typing import Any

from clradar.dataset.plan.draws import Draw
from clradar.dataset.plan.hand_json import pose_record, shape_record
from clradar.dataset.plan.plan import Alpha, Plan, PlanMaterials
from clradar.hand import HandPose, HandShape
from clradar.model import Material
from clradar.model.material_file import material_record
from clradar.tracing.settings import SimulationSettings


def plan_record(plan: Plan) -> dict[str, Any]:
    """Return a plan so that `plan_from` gives it back, to the last bit.

    Poses are written out with their angles: the record does not change when the poses of the
    package or the pose files do.
    """
    record = _json(plan)
    del record["folder"]
    poses = record["poses"]
    poses["resolved"] = poses.pop("poses", [])
    if plan.poses.kind != "interpolation":
        del poses["share"]
    if plan.poses.kind != "around":
        del poses["spread_deg"]
    return record


def _json(value: Any) -> Any:
    if isinstance(value, Draw):
        return value.to_plain()
    if isinstance(value, HandPose):
        return pose_record(value)
    if isinstance(value, HandShape):
        return shape_record(value)
    if isinstance(value, Material):
        return material_record(value)
    if isinstance(value, Alpha | PlanMaterials):
        return {name: _json(draw) for name, draw in {**value.parts, "others": value.others}.items()}
    if isinstance(value, SimulationSettings):
        return _simulation(value)
    if is_dataclass(value):
        pairs = ((f.name, getattr(value, f.name)) for f in fields(value))
        return {name: _json(item) for name, item in pairs if item not in (None, ())}
    if isinstance(value, tuple):
        return [_json(item) for item in value]
    return value


def _simulation(settings: SimulationSettings) -> dict[str, Any]:
    record: dict[str, Any] = {"estimator": settings.estimator}
    for name, value in asdict(settings).items():
        if name == "reception_radius_m":
            record["reception_radius_mm"] = _millimetres(value)
        elif name != "seed" and value is not None:
            record[name] = value
    return record


def _millimetres(length_m: float) -> float:
    """Return the shortest decimal number of millimetres that is read as this length."""
    for digits in range(17):
        length_mm = round(1e3 * length_m, digits)
        if length_mm / 1e3 == length_m:
            return length_mm
    return 1e3 * length_m

"""The tables [poses], [hands], [placement], [movement] and alpha of a plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from clradar.dataset.plan.draws import Draw, fixed
from clradar.dataset.plan.hand_json import pose_of, shape_of
from clradar.dataset.plan.plan import Alpha, Hands, MovementPlan, Placement, Poses, RigFile
from clradar.dataset.plan.table import PlanTable
from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import clean
from clradar.files.hashing import sha256_of
from clradar.files.table import choice_text, is_number
from clradar.hand import (
    DIGITS,
    LETTERS,
    PART_NAMES,
    POSES,
    HandPose,
    HandShape,
    pose_by_name,
    read_pose,
)
from clradar.hand.movement import RATE_HZ
from clradar.hand.sampler import MOST_SPREAD_DEG, SPREAD_DEG
from clradar.hand.shape import BREADTH_LIMITS_M, FACTOR_LIMITS, LENGTH_LIMITS_M
from clradar.motion.timing import ORDERS, STEP_S

POSE_SETS = {"letters": LETTERS, "digits": DIGITS, "all": (*LETTERS, *DIGITS)}
"""Names of sets of poses."""

EDGE_MM = 2.0
"""About 29 000 faces; see docs/datasets.md for what other lengths cost and err."""

NEAREST_MM, FARTHEST_MM = 100.0, 3000.0
"""Limits of the centre of a hand along z."""

SIDE_MM = 1000.0
MOST_FRAMES = 10_000


def poses_of(table: PlanTable, folder: Path) -> Poses:
    kind = table.one_of("kind", "list", ("list", "interpolation", "around", "sampler"))
    found: list[HandPose] = []
    for name in _names(table):
        if not any(known.casefold() == name.casefold() for known in POSES):
            table.refuse("names", choice_text(name, tuple(POSES)), name)
        else:
            found.append(pose_by_name(name))
    for i, name in enumerate(table.texts("files", (), "names of pose files")):
        pose = table.checked(f"files[{i}]", read_pose, folder / name)
        found += [] if pose is None else [pose]
    found += _resolved_poses(table)
    order = table.one_of("order", "cycle", ("cycle", "random"))
    share = table.draw("share", Draw("uniform", (0.0, 1.0)), 0.0, 1.0, ("uniform", "choice"))
    if table.has("share") and kind != "interpolation":
        table.refuse("share", 'no share unless kind = "interpolation"', table.raw("share"))
    spread_deg = table.number("spread_deg", SPREAD_DEG, 0.0, MOST_SPREAD_DEG)
    if table.has("spread_deg") and kind != "around":
        table.refuse("spread_deg", 'none unless kind = "around"', table.raw("spread_deg"))
    if kind == "sampler" and found:
        table.mistake("kind", 'no poses with "sampler", which makes its own', f"{len(found)} poses")
    elif kind != "sampler" and not any(table.has(k) for k in ("names", "files", "resolved")):
        table.mistake("names", 'poses, such as "letters" or ["A", "B"]', "nothing")
    elif kind == "interpolation" and 0 < len(found) < 2:
        table.mistake("names", "at least two poses to interpolate between", f"{len(found)}")
    counts = [pose.name for pose in found]
    for name in sorted({n for n in counts if counts.count(n) > 1}):
        table.mistake("files", "poses with different names", f"'{name}' more than once")
    table.done()
    return Poses(kind, tuple(found), order, share, spread_deg)


def _names(table: PlanTable) -> tuple[str, ...]:
    given = table.raw("names", [])
    if isinstance(given, str):
        if given in POSE_SETS:
            return POSE_SETS[given]
        choices = (*POSE_SETS, "a list of names")
        table.refuse("names", choice_text(given, choices), given)
        return ()
    return table.texts("names", (), "names of poses")


def _resolved_poses(table: PlanTable) -> list[HandPose]:
    """Return poses with their angles written out, as in manifests."""
    found = []
    for i, record in enumerate(table.entries("resolved", "poses with their angles")):
        try:
            found.append(pose_of(record))
        except (ClradarError, KeyError, TypeError, AttributeError, ValueError) as error:
            table.mistake(f"resolved[{i}]", "a name and joints_rad", clean(repr(error)))
    return found


def hands_of(table: PlanTable, folder: Path) -> Hands:
    rigs = _rigs(table, folder)
    sides = ("right", "left", "both", *(("as it is",) if rigs else ()))
    handedness = table.one_of("handedness", sides[-1] if rigs else "right", sides)
    shapes = _shapes(table)
    default = "list" if shapes else "default"
    shape = table.one_of("shape", default, ("default", "sampled", "list"))
    if (shape == "list") != bool(shapes):
        table.refuse("shapes", 'a list of shapes with shape = "list", and else none', shape)
    if rigs and shape != "default":
        table.refuse("shape", "none with rigs, which have shapes of their own", shape)
    edge_mm = table.number("edge_mm", EDGE_MM, 0.5, 4.0)
    table.done()
    return Hands(handedness, shape, tuple(shapes), tuple(rigs), edge_mm)


def _rigs(table: PlanTable, folder: Path) -> list[RigFile]:
    found = []
    for i, content in enumerate(table.entries("rigs", "rig files")):
        content = {"file": content} if isinstance(content, str) else content
        inner = table.inner(f"rigs[{i}]", content)
        rig = _resolved_rig(inner) if inner.has("sha256") else _rig(inner, folder)
        found += [] if rig is None else [rig]
    return found


def _is_text(value: object) -> bool:
    return isinstance(value, str) and value != ""


_RIG_VALUES: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "file": ("the name of a file", _is_text),
    "sha256": ("a SHA-256", _is_text),
    "handedness": ('"right" or "left"', lambda value: value in ("right", "left")),
    "mapping": ("the name of a file", _is_text),
    "mapping_sha256": ("a SHA-256", _is_text),
    "unit": ("a unit or a number", lambda value: _is_text(value) or is_number(value)),
    "betas": ("a list of numbers", lambda v: isinstance(v, list) and all(map(is_number, v))),
}
RIG_KEYS = tuple(_RIG_VALUES)


def _resolved_rig(table: PlanTable) -> RigFile | None:
    """Return a rig as in manifests; its file is verified where it is used."""
    found = {key: table.raw(key) for key in RIG_KEYS if table.has(key)}
    table.done()
    if not {"file", "sha256", "handedness"} <= set(found):
        table.mistake("", f"the keys {', '.join(RIG_KEYS)}", ", ".join(found))
        return None
    for key, (expected, good) in _RIG_VALUES.items():
        if found.get(key) is not None and not good(found[key]):
            table.refuse(key, expected, found[key])
            return None
    return RigFile(**{**found, "betas": tuple(found.get("betas") or ())})


def _rig(table: PlanTable, folder: Path) -> RigFile | None:
    from clradar.rigs import read_rig

    file, mapping = table.raw("file"), table.raw("mapping")
    for key, value in (("file", file), ("mapping", mapping)):
        if (value is not None or key == "file") and not (isinstance(value, str) and value):
            table.refuse(key, "the name of a file", value)
            return None
    options = {key: table.raw(key) for key in ("unit", "handedness", "betas") if table.has(key)}
    table.done()
    path = folder / file
    names = None if mapping is None else folder / mapping

    def read() -> RigFile:
        # Read once, so that a file that is no rig is found before the first sample.
        try:
            rig = read_rig(path, mapping=names, **options)
        except ClradarError as error:  # it names the option of the command
            raise MeasurementError(str(error).replace("--mapping", "the key mapping")) from error
        return RigFile(
            file=file,
            sha256=sha256_of(path),
            handedness=rig.handedness,
            mapping=mapping,
            mapping_sha256=None if names is None else sha256_of(names),
            unit=options.get("unit"),
            betas=tuple(float(beta) for beta in options.get("betas", ())),
        )

    return table.checked("", read)


def _shapes(table: PlanTable) -> list[HandShape]:
    found = []
    for i, content in enumerate(table.entries("shapes", "tables")):
        inner = table.inner(f"shapes[{i}]", content)
        average = HandShape()
        values: dict[str, Any] = {"girth": inner.number("girth", average.girth, *FACTOR_LIMITS)}
        for key, limits_m in (("length", LENGTH_LIMITS_M), ("breadth", BREADTH_LIMITS_M)):
            value_m = getattr(average, f"{key}_m")
            if inner.has(f"{key}_m"):  # of a manifest, which reads back to the last bit
                values[f"{key}_m"] = inner.number(f"{key}_m", value_m, *limits_m)
            elif inner.has(f"{key}_mm"):
                low_mm, high_mm = (1e3 * limit_m for limit_m in limits_m)
                value_mm = inner.number(f"{key}_mm", 1e3 * value_m, low_mm, high_mm)
                values[f"{key}_m"] = value_mm / 1e3
            else:
                values[f"{key}_m"] = value_m
        values["finger_lengths"] = inner.numbers("finger_lengths", average.finger_lengths, 5)
        inner.done(("length_mm", "breadth_mm"))
        shape = table.checked(f"shapes[{i}]", shape_of, values)
        found += [] if shape is None else [shape]
    return found


def placement_of(table: PlanTable) -> Placement:
    zero = fixed(0.0)
    found = Placement(
        x_mm=table.draw("x_mm", zero, -SIDE_MM, SIDE_MM),
        y_mm=table.draw("y_mm", zero, -SIDE_MM, SIDE_MM),
        z_mm=table.draw("z_mm", fixed(300.0), NEAREST_MM, FARTHEST_MM),
        rotation_x_deg=table.draw("rotation_x_deg", zero, -360.0, 360.0),
        rotation_y_deg=table.draw("rotation_y_deg", zero, -360.0, 360.0),
        rotation_z_deg=table.draw("rotation_z_deg", zero, -360.0, 360.0),
    )
    table.done()
    return found


def movement_of(table: PlanTable) -> MovementPlan:
    zero = fixed(0.0)
    found = MovementPlan(
        frames=table.whole("frames", 8, 2, MOST_FRAMES),
        rate_hz=table.number("rate_hz", RATE_HZ, 0.0, 1e6, above=True),
        poses=table.one_of("poses", "next", ("next", "stay")),
        x_mm=table.draw("x_mm", zero, -SIDE_MM, SIDE_MM),
        y_mm=table.draw("y_mm", zero, -SIDE_MM, SIDE_MM),
        z_mm=table.draw("z_mm", zero, -SIDE_MM, SIDE_MM),
        rotation_x_deg=table.draw("rotation_x_deg", zero, -360.0, 360.0),
        rotation_y_deg=table.draw("rotation_y_deg", zero, -360.0, 360.0),
        rotation_z_deg=table.draw("rotation_z_deg", zero, -360.0, 360.0),
        order=table.one_of("order", "tx", ORDERS),
        step_us=table.number("step_us", 1e6 * STEP_S, 0.0, 1e6),
    )
    table.done()
    return found


def alpha_of(top: PlanTable) -> Alpha:
    kinds = ("uniform", "choice")
    default = fixed(0.5)
    given = top.raw("alpha", 0.5)
    names = (*PART_NAMES, "others")
    if not isinstance(given, dict) or (len(given) == 1 and next(iter(given)) not in names):
        return Alpha({}, top.draw("alpha", default, 0.0, 1.0, kinds))
    table = top.table("alpha")
    others = table.draw("others", default, 0.0, 1.0, kinds)
    parts = {
        name: table.draw(name, default, 0.0, 1.0, kinds) for name in PART_NAMES if table.has(name)
    }
    table.done(PART_NAMES)
    return Alpha(parts, others)

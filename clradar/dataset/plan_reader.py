"""Read a plan from TOML, or from what a manifest keeps of it; list all its mistakes."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clradar.backproject import METHODS, WINDOWS
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.dataset.draws import Draw, fixed
from clradar.dataset.hands import pose_of, shape_of
from clradar.dataset.plan import (
    PRODUCTS,
    Alpha,
    ChannelErrors,
    Hands,
    Image,
    Impairments,
    Output,
    Placement,
    Plan,
    Poses,
    Radar,
    Simulation,
    WallPlan,
)
from clradar.dataset.plan_table import PlanError, PlanTable, choice_text, is_number
from clradar.errors import ClradarError
from clradar.hand import DIGITS, LETTERS, POSES, HandPose, HandShape, pose_by_name, read_pose
from clradar.model import VoxelGrid
from clradar.normals import CREASE_DEG
from clradar.trace import RECEPTION_RADIUS_M, resolve_settings
from measurement_io.failures import clean, fail, read_bytes, reading, shown

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_PLAN_BYTES = 2**20
MAX_LINE = 2**14
MAX_SAMPLES = 10**8
MAX_SHARD = 4096
EXPECTED = "a plan of a data set (a TOML file, see docs/datasets.md)"

PARTS = ("palm", "thumb", "index", "middle", "ring", "pinky")
"""Of a hand; each can have an alpha of its own."""

POSE_SETS = {"letters": LETTERS, "digits": DIGITS, "all": (*LETTERS, *DIGITS)}
"""Names that stand for many poses."""

EDGE_MM = 2.5
"""About 19 000 faces. The image differs from that of 41 000 by less than the noise of its samples."""

SAMPLES_PER_MM2, RAYS_PER_SAMPLE = 0.25, 160
"""A quarter of the samples that `simulate` takes by default, with four times the rays: same scale."""

GRID_MM = {"x_mm": (-100.0, 100.0), "y_mm": (-100.0, 100.0), "z_mm": (250.0, 350.0)}
STEP_MM = 2.0

NEAREST_MM, FARTHEST_MM = 100.0, 3000.0
"""Where the centre of a hand may be along z."""

SIDE_MM = 1000.0
DECIBELS = 300.0


def read_plan(path: str | os.PathLike[str]) -> Plan:
    """Return the plan of a TOML file; docs/datasets.md lists what it can say.

    Raises
    ------
    PlanError
        Its `mistakes` has one line for each thing that cannot be meant: the file, the key, what was
        expected, and what was found.
    MeasurementError
        The file is missing or no TOML.
    """
    path = Path(path)
    content = read_bytes(path, EXPECTED, MAX_PLAN_BYTES)
    with reading(path, EXPECTED):
        text = content.decode("utf-8-sig")
        # A key of thousands of dotted parts keeps the parser busy for minutes.
        longest = max((len(line) for line in text.splitlines()), default=0)
        if longest > MAX_LINE:
            fail(path, f"lines of at most {MAX_LINE} characters", f"{longest}")
        try:
            parsed = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            fail(path, EXPECTED, clean(error))
    return plan_from(parsed, shown(path), path.absolute().parent)


def plan_from(parsed: Mapping[str, Any], source: str, folder: Path) -> Plan:
    """Return the plan of a mapping as TOML or JSON gives it.

    Parameters
    ----------
    parsed : mapping
    source : str
        What the mapping was read from, for messages.
    folder : Path
        What the names of files in it are relative to.
    """
    mistakes: list[str] = []
    top = PlanTable(source, "", dict(parsed), mistakes)
    plan = Plan(
        seed=top.whole("seed", 0, 0, 2**63 - 1),
        samples=_samples(top),
        poses=_poses(top.table("poses"), folder),
        hands=_hands(top.table("hands"), folder),
        placement=_placement(top.table("placement")),
        alpha=_alpha(top),
        impairments=_impairments(top.table("impairments")),
        radar=_radar(top.table("radar")),
        simulation=_simulation(top.table("simulation")),
        image=_image(top.table("image")),
        output=_output(top.table("output")),
    )
    top.done()
    if not mistakes:
        _check_together(top, plan)
    if mistakes:
        raise PlanError(mistakes)
    return plan


def _samples(top: PlanTable) -> int:
    if not top.has("samples"):
        top.raw("samples")
        top.mistake("samples", "the number of samples", "nothing")
        return 1
    return top.whole("samples", 1, 1, MAX_SAMPLES)


def _poses(table: PlanTable, folder: Path) -> Poses:
    kind = table.one_of("kind", "list", ("list", "interpolation", "sampler"))
    found: list[HandPose] = []
    for name in _names(table):
        if not any(known.casefold() == name.casefold() for known in POSES):
            table.mistake("names", choice_text(name, tuple(POSES)), name)
        else:
            found.append(pose_by_name(name))
    for i, name in enumerate(table.texts("files", (), "names of pose files")):
        file = folder / name
        pose = table.checked(f"files[{i}]", lambda file=file: read_pose(file), None)
        found += [] if pose is None else [pose]
    found += _resolved_poses(table)
    order = table.one_of("order", "cycle", ("cycle", "random"))
    share = table.draw("share", Draw("uniform", (0.0, 1.0)), 0.0, 1.0, ("uniform", "choice"))
    if table.has("share") and kind != "interpolation":
        table.mistake("share", 'no share unless kind = "interpolation"', table.raw("share"))
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
    return Poses(kind, tuple(found), order, share)


def _names(table: PlanTable) -> tuple[str, ...]:
    given = table.raw("names", [])
    if isinstance(given, str):
        if given in POSE_SETS:
            return POSE_SETS[given]
        choices = (*POSE_SETS, "a list of names")
        table.mistake("names", choice_text(given, choices), given)
        return ()
    return table.texts("names", (), "names of poses")


def _resolved_poses(table: PlanTable) -> list[HandPose]:
    """Return poses with their angles written out, as manifests have them."""
    found = []
    given = table.raw("resolved", [])
    if not isinstance(given, list):
        table.mistake("resolved", "a list of poses with their angles", given)
        return []
    for i, record in enumerate(given):
        try:
            found.append(pose_of(record))
        except (ClradarError, KeyError, TypeError, AttributeError, ValueError) as error:
            table.mistake(f"resolved[{i}]", "a name and joints_rad", clean(repr(error)))
    return found


def _hands(table: PlanTable, folder: Path) -> Hands:
    handedness = table.one_of("handedness", "right", ("right", "left", "both"))
    shapes = _shapes(table)
    default = "list" if shapes else "default"
    shape = table.one_of("shape", default, ("default", "sampled", "list"))
    if (shape == "list") != bool(shapes):
        table.mistake("shapes", 'a list of shapes with shape = "list", and else none', shape)
    edge_mm = table.number("edge_mm", EDGE_MM, 0.5, 4.0)
    table.done()
    return Hands(handedness, shape, tuple(shapes), (), edge_mm)


def _shapes(table: PlanTable) -> list[HandShape]:
    given = table.raw("shapes", [])
    if not isinstance(given, list):
        table.mistake("shapes", "a list of tables", given)
        return []
    found = []
    for i, content in enumerate(given):
        inner = table.inner(f"shapes[{i}]", content)
        average = HandShape()
        values: dict[str, Any] = {"girth": inner.number("girth", average.girth, 0.0, 10.0)}
        for key in ("length", "breadth"):
            value_m = getattr(average, f"{key}_m")
            if inner.has(f"{key}_m"):  # a manifest's, which has to come back to the last bit
                values[f"{key}_m"] = inner.number(f"{key}_m", value_m, 0.0, 1.0)
            elif inner.has(f"{key}_mm"):
                values[f"{key}_m"] = inner.number(f"{key}_mm", 0.0, 0.0, 1000.0) / 1e3
            else:
                values[f"{key}_m"] = value_m
        values["finger_lengths"] = inner.numbers("finger_lengths", average.finger_lengths, 5)
        inner.done(("length_mm", "breadth_mm"))
        shape = table.checked(f"shapes[{i}]", lambda values=values: shape_of(values), None)
        found += [] if shape is None else [shape]
    return found


def _placement(table: PlanTable) -> Placement:
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


def _alpha(top: PlanTable) -> Alpha:
    kinds = ("uniform", "choice")
    default = fixed(0.5)
    given = top.raw("alpha", 0.5)
    if not isinstance(given, dict) or (len(given) == 1 and next(iter(given)) in kinds):
        return Alpha({}, top.draw("alpha", default, 0.0, 1.0, kinds))
    table = top.table("alpha")
    others = table.draw("others", default, 0.0, 1.0, kinds)
    parts = {name: table.draw(name, default, 0.0, 1.0, kinds) for name in PARTS if table.has(name)}
    table.done(PARTS)
    return Alpha(parts, others)


def _impairments(table: PlanTable) -> Impairments:
    zero = fixed(0.0)
    level = {
        key: table.draw(key, zero, -DECIBELS, DECIBELS) if table.has(key) else None
        for key in ("snr_db", "coupling_db")
    }
    delay = table.draw("coupling_delay_ps", zero, -1e6, 1e6)
    if level["coupling_db"] is None and delay.bounds() != (0.0, 0.0):
        table.mistake("coupling_delay_ps", "coupling_db with it", "none")
    adc_bits = table.whole("adc_bits", 14, 2, 24) if table.has("adc_bits") else None
    found = Impairments(
        snr_db=level["snr_db"],
        coupling_db=level["coupling_db"],
        coupling_delay_ps=delay,
        iq_gain_db=table.draw("iq_gain_db", zero, -DECIBELS, DECIBELS),
        iq_phase_deg=table.draw("iq_phase_deg", zero, -180.0, 180.0),
        adc_bits=adc_bits,
        channels=_channels(table.table("channels")) if table.has("channels") else None,
        walls=_walls(table),
    )
    table.done(("snr_db", "coupling_db", "adc_bits", "channels"))
    return found


def _channels(table: PlanTable) -> ChannelErrors:
    found = ChannelErrors(
        gain_db=table.number("gain_db", 3.0, 0.0, DECIBELS),
        phase_deg=table.number("phase_deg", 180.0, 0.0, 180.0),
        delay_ps=table.number("delay_ps", 20.0, 0.0, 1e6),
        dead_tx=table.whole_numbers("dead_tx", 0, 1023),
        dead_rx=table.whole_numbers("dead_rx", 0, 1023),
        per=table.one_of("per", "dataset", ("dataset", "sample")),
    )
    table.done()
    return found


def _walls(table: PlanTable) -> tuple[WallPlan, ...]:
    given = table.raw("walls", [])
    if not isinstance(given, list):
        table.mistake("walls", "a list of tables", given)
        return ()
    found = []
    for i, content in enumerate(given):
        inner = table.inner(f"walls[{i}]", content)
        point = inner.numbers("point_mm", (0.0, 0.0, 1000.0), 3)
        normal = inner.numbers("normal", (0.0, 0.0, -1.0), 3)
        if not any(normal):
            inner.mistake("normal", "a direction", list(normal))
        amplitude = inner.number("amplitude", 1.0, -1e12, 1e12)
        inner.done()
        found.append(WallPlan(point, normal, amplitude))
    return tuple(found)


def _radar(table: PlanTable) -> Radar:
    array = table.one_of("array", "qar50", ("qar50",))
    every = table.whole("every", 1, 1, 47)
    start = table.number("start_ghz", 72.0, 0.1, 1000.0)
    stop = table.number("stop_ghz", 82.0, 0.1, 1000.0)
    steps = table.whole("steps", 128, 1, 4096)
    if stop < start or (stop == start) != (steps == 1):
        table.mistake(
            "stop_ghz",
            "start_ghz < stop_ghz, or both the same with steps = 1",
            f"{start:g}, {stop:g}",
        )
    table.done()
    return Radar(array, every, start, stop, steps)


def _simulation(table: PlanTable) -> Simulation:
    estimator = table.one_of("estimator", "expected", ("expected", "stochastic"))
    density = None
    rays_per_face = None
    if table.has("rays_per_face"):
        rays_per_face = table.whole("rays_per_face", 1, 1, 2**20)
    if table.has("samples_per_mm2") or rays_per_face is None:
        default = SAMPLES_PER_MM2 if estimator == "expected" else 10.0
        density = table.number("samples_per_mm2", default, 0.0, 1e4, above=True)
    if density is not None and rays_per_face is not None:
        table.mistake("rays_per_face", "one of it and samples_per_mm2", "both")
        density = None
    rays = 1 if rays_per_face is not None else RAYS_PER_SAMPLE if estimator == "expected" else 4
    found = Simulation(
        estimator=estimator,
        samples_per_mm2=density,
        rays_per_face=rays_per_face,
        rays_per_sample=table.whole("rays_per_sample", rays, 1, 2**16),
        reception_radius_mm=table.number(
            "reception_radius_mm", 1e3 * RECEPTION_RADIUS_M, 0.0, 1000.0, above=True
        ),
        max_bounces=table.whole("max_bounces", 1, 1, 255),
        normals=table.one_of("normals", "smooth", ("smooth", "face")),
        crease_deg=table.number("crease_deg", CREASE_DEG, 0.0, 180.0),
        amplitude=table.one_of("amplitude", "unit", ("unit", "spreading")),
        pattern_exponent=table.number("pattern_exponent", 0.0, 0.0, 100.0),
    )
    table.checked("", lambda: simulation_settings(found, 0), None)
    table.done(("samples_per_mm2", "rays_per_face"))
    return found


def simulation_settings(simulation: Simulation, seed: int) -> Any:
    """Return the arguments of `clradar.simulate` that a plan's table stands for, checked."""
    return resolve_settings(
        samples_per_mm2=simulation.samples_per_mm2,
        rays_per_face=simulation.rays_per_face,
        rays_per_sample=simulation.rays_per_sample,
        reception_radius_m=simulation.reception_radius_mm / 1e3,
        max_bounces=simulation.max_bounces,
        normals=simulation.normals,
        crease_deg=simulation.crease_deg,
        amplitude=simulation.amplitude,
        pattern_exponent=simulation.pattern_exponent,
        seed=seed,
        estimator=simulation.estimator,
    )


def _image(table: PlanTable) -> Image:
    extents = []
    for key, (first, last) in GRID_MM.items():
        low, high = table.numbers(key, (first, last), 2)
        if high < low:
            table.mistake(key, "[first, last] with first <= last", [low, high])
        extents.append((low, high))
    step = table.raw("step_mm", STEP_MM)
    steps = (float(step),) * 3 if is_number(step) else table.numbers("step_mm", (STEP_MM,) * 3, 3)
    if min(steps) <= 0:
        table.mistake("step_mm", "a positive step, or three of them", step)
        steps = (STEP_MM,) * 3
    method = table.one_of("method", "fast", METHODS)
    tolerance = None
    if table.has("tolerance_db") and table.raw("tolerance_db") is not None:
        tolerance = table.number("tolerance_db", -50.0, -80.0, -30.0)
        if method != "fast":
            table.mistake("tolerance_db", 'none unless method = "fast"', f"{tolerance:g}")
    found = Image(
        *extents,
        step_mm=(steps[0], steps[1], steps[2]),
        method=method,
        window=table.one_of("window", "rect", WINDOWS),
        tolerance_db=tolerance,
        dynamic_range_db=table.number("dynamic_range_db", DYNAMIC_RANGE_DB, 0.0, 300.0, above=True),
    )
    table.checked("", lambda: grid_of(found), None)
    table.done(("tolerance_db",))
    return found


def grid_of(image: Image) -> VoxelGrid:
    """Return the voxel grid of a plan."""
    x_m, y_m, z_m = ((low / 1e3, high / 1e3) for low, high in (image.x_mm, image.y_mm, image.z_mm))
    return VoxelGrid.from_extent(x_m, y_m, z_m, [step / 1e3 for step in image.step_mm])


def _output(table: PlanTable) -> Output:
    given = table.texts("products", ("max_projection", "depth_map", "joints"), "products")
    for name in given:
        if name not in PRODUCTS:
            table.mistake("products", choice_text(name, PRODUCTS), name)
    if table.has("products") and not given:
        table.mistake("products", f"at least one of {', '.join(PRODUCTS)}", "none")
    found = Output(
        products=tuple(name for name in PRODUCTS if name in given),
        shard_size=table.whole("shard_size", 64, 1, MAX_SHARD),
        compression=table.whole("compression", 1, 0, 9),
    )
    table.done()
    return found


def _check_together(top: PlanTable, plan: Plan) -> None:
    """Note what only two tables together can get wrong."""
    channels = plan.impairments.channels
    count = -(-94 // plan.radar.every)
    if channels is not None:
        for key, dead in (("dead_tx", channels.dead_tx), ("dead_rx", channels.dead_rx)):
            if dead and max(dead) >= count:
                top.mistake(
                    f"impairments.channels.{key}", f"channels from 0 to {count - 1}", f"{max(dead)}"
                )
    if plan.impairments.any and not plan.needs_capture:
        top.mistake(
            "impairments",
            "a product that they change (capture, volume, max_projection or depth_map)",
            ", ".join(plan.output.products),
        )
    if plan.keeps_images:
        _check_hands_are_seen(top, plan)


def _check_hands_are_seen(top: PlanTable, plan: Plan) -> None:
    for key in ("x_mm", "y_mm", "z_mm"):
        drawn: Draw = getattr(plan.placement, key)
        least, greatest = drawn.values if drawn.kind == "uniform" else drawn.bounds()
        if drawn.kind == "normal":
            least = greatest = drawn.values[0]
        first, last = getattr(plan.image, key)
        if not first <= least <= greatest <= last:
            top.mistake(
                f"placement.{key}",
                f"hands in the image (image.{key} is {first:g} to {last:g})",
                f"{least:g} to {greatest:g}",
            )

"""The tables [impairments], [radar], [simulation] and [image] of a plan."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from clradar.arrays import read_array
from clradar.arrays.array_file import array_of, array_record
from clradar.arrays.instruments import KNOWN
from clradar.backproject import METHODS, WINDOWS
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.dataset.plan.draws import fixed
from clradar.dataset.plan.plan import ChannelErrors, Image, Impairments, RadarPlan, WallPlan
from clradar.dataset.plan.table import PlanTable
from clradar.files.table import choice_text, is_number
from clradar.geometry.normals import CREASE_DEG
from clradar.model import AntennaArray, VoxelGrid
from clradar.tracing.settings import (
    PHYSICAL_SAMPLES_PER_MM2,
    RECEPTION_RADIUS_M,
    SimulationSettings,
)

DENSITIES_PER_MM2 = {
    "expected": 0.25,
    "stochastic": 10.0,
    "physical": PHYSICAL_SAMPLES_PER_MM2,
}

RAYS_PER_SAMPLE = 160
"""With the expected estimator: as many rays per square millimetre as the stochastic one has by
default in `simulate`, so amplitudes have its scale."""

QAR50 = "qar50"
GRID_MM = {"x_mm": (-100.0, 100.0), "y_mm": (-100.0, 100.0), "z_mm": (250.0, 350.0)}
STEP_MM = 2.0

DECIBELS = 300.0


def impairments_of(table: PlanTable) -> Impairments:
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
    found = []
    for i, content in enumerate(table.entries("walls", "tables")):
        inner = table.inner(f"walls[{i}]", content)
        point = inner.numbers("point_mm", (0.0, 0.0, 1000.0), 3)
        normal = inner.numbers("normal", (0.0, 0.0, -1.0), 3)
        if not any(normal):
            inner.refuse("normal", "a direction", list(normal))
        amplitude = inner.number("amplitude", 1.0, -1e12, 1e12)
        inner.done()
        found.append(WallPlan(point, normal, amplitude))
    return tuple(found)


def radar_of(table: PlanTable, folder: Path) -> RadarPlan:
    array = _array(table, folder)
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
    return RadarPlan(array, every, start, stop, steps)


def _array(table: PlanTable, folder: Path) -> str | dict[str, Any]:
    """A known array's name, or the antennas of a file; the latter as they are in manifests."""
    named = table.raw("array", QAR50)
    if isinstance(named, dict):
        found = table.checked("array", array_of, named, "array", "array")
    elif named in KNOWN:
        return str(named)
    elif isinstance(named, str) and named.endswith(".toml"):
        found = table.checked("array", read_array, folder / named)
    else:
        expected = f"{choice_text(str(named), tuple(KNOWN))}, or a .toml file of antennas"
        table.refuse("array", expected, named)
        return QAR50
    return QAR50 if found is None else array_record(found)


def plan_array(array: str | Mapping[str, Any], every: int) -> AntennaArray:
    """Return every n-th antenna of a plan's array; equal ones are the same object."""
    return _part(array if isinstance(array, str) else json.dumps(array), every)


@lru_cache(maxsize=8)
def _part(array: str, every: int) -> AntennaArray:
    whole = KNOWN[array]() if array in KNOWN else array_of(json.loads(array), "array", "array")
    if every == 1:
        return whole
    one_in = slice(None, None, every)
    return whole.part(one_in, one_in, f"{whole.name}, one in {every}")


def simulation_of(table: PlanTable) -> SimulationSettings:
    estimator = table.one_of("estimator", "expected", ("expected", "stochastic", "physical"))
    physical = estimator == "physical"
    density = None
    rays_per_face = None
    if table.has("rays_per_face"):
        rays_per_face = table.whole("rays_per_face", 1, 1, 2**20)
    if table.has("samples_per_mm2") or rays_per_face is None:
        default = DENSITIES_PER_MM2[estimator]
        density = table.number("samples_per_mm2", default, 0.0, 1e4, above=True)
    if density is not None and rays_per_face is not None:
        table.mistake("rays_per_face", "one of it and samples_per_mm2", "both")
        density = None
    rays = 1 if rays_per_face is not None else RAYS_PER_SAMPLE if estimator == "expected" else 4
    values: dict[str, Any] = {
        "estimator": estimator,
        "samples_per_mm2": density,
        "rays_per_face": rays_per_face,
        "rays_per_sample": table.whole("rays_per_sample", None if physical else rays, 1, 2**16),
        "reception_radius_m": table.number(
            "reception_radius_mm", 1e3 * RECEPTION_RADIUS_M, 0.0, 1000.0, above=True
        )
        / 1e3,
        "max_bounces": table.whole("max_bounces", 1, 1, 255),
        "normals": table.one_of("normals", "smooth", ("smooth", "face")),
        "crease_deg": table.number("crease_deg", CREASE_DEG, 0.0, 180.0),
        "facets": table.one_of("facets", "curved", ("curved", "flat")),
        "amplitude": table.one_of("amplitude", "unit", ("unit", "spreading")),
        "pattern_exponent": table.number("pattern_exponent", 0.0, 0.0, 100.0),
    }
    found = table.checked("", lambda: SimulationSettings(**values))
    table.done(("samples_per_mm2", "rays_per_face"))
    return SimulationSettings() if found is None else found


def image_of(table: PlanTable) -> Image:
    extents: list[tuple[float, float]] = []
    for key, (first, last) in GRID_MM.items():
        low, high = table.numbers(key, (first, last), 2)
        if high < low:
            table.refuse(key, "[first, last] with first <= last", [low, high])
            low, high = first, last
        extents.append((low, high))
    step = table.raw("step_mm", STEP_MM)
    steps = (float(step),) * 3 if is_number(step) else table.numbers("step_mm", (STEP_MM,) * 3, 3)
    if min(steps) <= 0:
        table.refuse("step_mm", "a positive step, or three of them", step)
        steps = (STEP_MM,) * 3
    method = table.one_of("method", "fast", METHODS)
    tolerance = None
    if table.has("tolerance_db") and table.raw("tolerance_db") is not None:
        tolerance = table.number("tolerance_db", -50.0, -80.0, -30.0)
        if method != "fast":
            table.mistake("tolerance_db", 'none unless method = "fast"', f"{tolerance:g}")
    found = Image(
        extents[0],
        extents[1],
        extents[2],
        step_mm=(steps[0], steps[1], steps[2]),
        method=method,
        window=table.one_of("window", "rect", WINDOWS),
        tolerance_db=tolerance,
        dynamic_range_db=table.number("dynamic_range_db", DYNAMIC_RANGE_DB, 0.0, 300.0, above=True),
    )
    table.checked("", plan_grid, found)
    table.done(("tolerance_db",))
    return found


def plan_grid(image: Image) -> VoxelGrid:
    """Return the voxel grid of a plan."""
    x_m, y_m, z_m = ((low / 1e3, high / 1e3) for low, high in (image.x_mm, image.y_mm, image.z_mm))
    return VoxelGrid.from_extent(x_m, y_m, z_m, [step / 1e3 for step in image.step_mm])

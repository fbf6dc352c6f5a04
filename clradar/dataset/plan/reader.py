"""Read a plan from TOML, or from the copy in a manifest, and report all its mistakes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clradar.dataset.plan.hand_tables import (
    alpha_of,
    hands_of,
    movement_of,
    placement_of,
    poses_of,
)
from clradar.dataset.plan.material_table import materials_of
from clradar.dataset.plan.plan import PRODUCTS, Output, Plan
from clradar.dataset.plan.radar_tables import (
    image_of,
    impairments_of,
    plan_array,
    radar_of,
    simulation_of,
)
from clradar.dataset.plan.table import PlanError, PlanTable
from clradar.files.failures import shown
from clradar.files.limits import MAX_PLAN_BYTES
from clradar.files.table import choice_text
from clradar.files.toml_file import read_toml

MAX_SAMPLES = 10**8
MAX_SHARD = 4096
MAX_SHARDS = 50_000
"""Limit of the manifest's size."""

EXPECTED = "a plan of a data set (a TOML file, see docs/datasets.md)"


def read_plan(path: str | os.PathLike[str]) -> Plan:
    """Return the plan of a TOML file; docs/datasets.md lists its keys.

    Raises
    ------
    PlanError
        Its `mistakes` has one line for each invalid key: the file, the key, what was expected, and
        what was found.
    MeasurementError
        The file is missing or no TOML.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import read_plan
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> plan = read_plan("plan.toml")
    >>> plan.simulation.estimator, plan.placement.z_mm.values
    ('expected', (300.0,))
    """
    path = Path(path)
    parsed = read_toml(path, EXPECTED, limit=MAX_PLAN_BYTES)
    return plan_from(parsed, shown(path), path.absolute().parent)


def plan_from(parsed: Mapping[str, Any], source: str, folder: Path) -> Plan:
    """Return the plan of a mapping from TOML or JSON.

    `source` is the name of its file, for messages; names of other files are relative to `folder`.
    """
    mistakes: list[str] = []
    top = PlanTable(source, "", dict(parsed), mistakes)
    simulation = simulation_of(top.table("simulation"))
    physical = simulation.estimator == "physical"
    plan = Plan(
        seed=top.whole("seed", 0, 0, 2**63 - 1),
        samples=_samples(top),
        poses=poses_of(top.table("poses"), folder),
        hands=hands_of(top.table("hands"), folder),
        placement=placement_of(top.table("placement")),
        alpha=None if physical else alpha_of(top),
        impairments=impairments_of(top.table("impairments")),
        radar=radar_of(top.table("radar"), folder),
        simulation=simulation,
        image=image_of(top.table("image")),
        output=_output(top.table("output")),
        material=materials_of(top, folder) if physical else None,
        movement=movement_of(top.table("movement")) if top.has("movement") else None,
        folder=folder.absolute(),
    )
    top.done(("alpha", "material", "movement"))
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


def _output(table: PlanTable) -> Output:
    given = table.texts("products", ("max_projection", "depth_map", "joints"), "products")
    for name in given:
        if name not in PRODUCTS:
            table.refuse("products", choice_text(name, PRODUCTS), name)
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
    """Report contradictions between tables."""
    if plan.material is not None and top.has("alpha"):
        top.mistake("alpha", "material in its place with simulation.estimator physical", "alpha")
    if plan.material is None and top.has("material"):
        words = plan.simulation.estimator
        top.mistake("material", "simulation.estimator physical with it", str(words))
    if plan.n_shards > MAX_SHARDS:
        least = -(-plan.samples // MAX_SHARDS)
        top.mistake(
            "output.shard_size",
            f"at least {least} for {plan.samples} samples ({MAX_SHARDS} files)",
            f"{plan.output.shard_size}",
        )
    channels = plan.impairments.channels
    if channels is not None:
        array = plan_array(plan.radar.array, plan.radar.every)
        for key, dead, count in (
            ("dead_tx", channels.dead_tx, array.n_tx),
            ("dead_rx", channels.dead_rx, array.n_rx),
        ):
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
    if plan.movement is not None:
        if plan.samples % plan.movement.frames:
            expected = f"a multiple of movement.frames, {plan.movement.frames}"
            top.mistake("samples", expected, f"{plan.samples}")
        if plan.hands.rigs:
            top.mistake("movement", "hands without rigs", "hands.rigs")
    if plan.keeps_images:
        _check_hands_are_imaged(top, plan)


def _check_hands_are_imaged(top: PlanTable, plan: Plan) -> None:
    for key in ("x_mm", "y_mm", "z_mm"):
        drawn = getattr(plan.placement, key)
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

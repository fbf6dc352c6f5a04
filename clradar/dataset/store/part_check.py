"""Verification of parts and of notes on samples set aside, which a crash may leave corrupt."""

from __future__ import annotations

import json
from pathlib import Path

from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.store.confined_reader import read_contents
from clradar.dataset.store.fields import data_bytes, fields_of_products
from clradar.files.failures import fail, reading
from clradar.files.json_file import read_json_object

EXPECTED = "a finished sample (HDF5)"


def check_part(path: Path, plan: Plan, sample: int) -> None:
    """Verify a part against its recipe; reading all of it verifies its checksums.

    Raises
    ------
    MeasurementError
        Damaged, or not this sample of this plan.
    """
    # Through JSON, as the stored one was.
    wanted = json.loads(json.dumps(recipe(plan, sample)))
    contents = read_contents(path, data_bytes(wanted))
    with reading(path, EXPECTED):
        found = contents.labels["sample"].tolist()
        if found != [sample]:
            fail(path, f"sample {sample}", f"{found}")
        if json.loads(contents.labels["recipe"][0]) != wanted:
            fail(path, f"sample {sample} of this plan", "one of another recipe")
        json.loads(contents.labels["made_with"][0])
        names = list(contents.arrays)
        if names != fields_of_products(plan.output.products):
            fail(path, f"the products {', '.join(plan.output.products)}", ", ".join(names))
        for name, axis in contents.axes.items():
            if not len(axis):
                fail(path, f"coordinates of {name}", "none")


def check_note(path: Path, sample: int) -> None:
    """Verify a note on why a sample was set aside.

    Raises
    ------
    MeasurementError
        Damaged, or of another sample.
    """
    record = read_json_object(path)
    with reading(path, "why a sample was set aside"):
        if record["sample"] != sample or set(record) != {"sample", "reason", "attempts"}:
            fail(path, f"why sample {sample} was set aside", "something else")

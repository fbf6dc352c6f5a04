"""Statistics, contact sheet and estimate of data sets."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from command_line import exit_status
from dataset_plans import (
    DEVICE,
    PLAN,
    digests,
)

from clradar.dataset import make_sample, open_dataset, recipe, run
from clradar.dataset.folder import CONTACT_SHEET, SHARDS, STATISTICS, SUMMARIES, TABLE, Manifest
from clradar.dataset.sample import Sample
from clradar.dataset.shards import FIELDS, write_sample
from clradar.dataset.summary import contact_sheet, statistics
from clradar.dataset.trial import estimate

SIZE_SHARE = 0.25
"""How far the estimate of bytes may be off: samples compress differently."""


def test_statistics_are_those_of_the_samples(made: Path) -> None:
    view = open_dataset(made)
    record = json.loads((made / STATISTICS).read_text())
    assert record["samples"] == 5
    assert record["counts"]["pose"] == {"A": 2, "B": 2, "F": 1}
    peaks = view.max_projection.max(("y_m", "x_m")).values.astype(np.float64)
    depths = view.depth_map.values
    for name, values in (
        ("max_projection: peak", peaks),
        ("center_m: z", view.center_m.values[:, 2]),
        ("alpha: thumb", view.alpha.values[:, 1]),
        ("depth_map: share with a depth", np.isfinite(depths).mean(axis=(1, 2))),
        ("depth_map: mean depth", np.nanmean(depths.astype(np.float64), axis=(1, 2))),
    ):
        found = record["quantities"][name]
        wanted = {
            "min": values.min(),
            "mean": values.mean(),
            "std": values.std(),
            "max": values.max(),
        }
        assert found["count"] == 5
        for key, value in wanted.items():
            assert found[key] == pytest.approx(value, rel=1e-9, abs=1e-12), (name, key)
    with open(made / TABLE, newline="") as file:
        rows = {row["quantity"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(record["quantities"])
    assert float(rows["center_m: z"]["mean"]) == record["quantities"]["center_m: z"]["mean"]


@pytest.mark.parametrize(("brightest", "silent"), [(0.0, [2]), (1e-6, [])])
def test_a_sample_is_silent_whose_image_is_zero_everywhere(
    brightest: float, silent: list[int], tmp_path: Path
) -> None:
    image = np.zeros((21, 21), np.float32)
    image[3, 5] = brightest
    sample = Sample(recipe(PLAN, 2), {"max_projection": image})
    (tmp_path / SHARDS).mkdir()
    write_sample(tmp_path / SHARDS / "shard-00001.h5", sample, {}, compression=1)
    assert statistics(tmp_path, Manifest(PLAN, shards={1}))["silent"] == silent


def test_there_is_a_contact_sheet(made: Path) -> None:
    from PIL import Image

    with Image.open(made / CONTACT_SHEET) as sheet:
        width, height = sheet.size
        colours = len(np.unique(np.asarray(sheet).reshape(-1, 4), axis=0))
    assert width > 2.5 * height  # five in a row
    assert colours > 100


@pytest.mark.parametrize("products", [["volume"], ["depth_map"], ["capture"], ["mesh", "joints"]])
def test_every_product_is_drawn_on_contact_sheets(products: list[str]) -> None:
    names = [name for p in products for name in FIELDS if name.partition("_")[0] == p or name == p]
    sample = make_sample({**recipe(PLAN, 2), "output": {"products": products}}, DEVICE)
    assert set(sample.arrays) == set(names)
    axes = contact_sheet([sample]).axes
    assert len(axes) == 1
    drawn = len(axes[0].images) + len(axes[0].lines)
    assert drawn == (6 if products == ["mesh", "joints"] else 1)  # the cloud, and five digits


def test_summaries_that_were_lost_are_written_again(copy: Path) -> None:
    before = digests(copy)
    for name in SUMMARIES:
        (copy / name).unlink()
    run(PLAN, copy, device=DEVICE)
    assert digests(copy) == before


def test_the_estimate_is_near_what_is_written(made: Path) -> None:
    seconds, size, _ = estimate(PLAN, device=DEVICE)
    made_bytes = sum(path.stat().st_size for path in (made / "shards").iterdir())
    assert abs(size - made_bytes) < SIZE_SHARE * made_bytes
    assert seconds > 0


def test_a_dry_run_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = "samples = 100000\n[poses]\nnames = ['A']\n[hands]\nedge_mm = 4\n"
    (tmp_path / "plan.toml").write_text(plan + "[output]\nproducts = ['joints']\n")
    assert exit_status("dataset", tmp_path / "plan.toml", "--dry-run", "-o", tmp_path / "out") == 0
    out = capsys.readouterr().out
    assert "all 100000 samples: " in out
    assert [path.name for path in tmp_path.iterdir()] == ["plan.toml"]


def test_wrong_usage_is_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (
        ["dataset"],
        ["dataset", "plan.toml", "--replay", "x", "1"],
        ["dataset", "plan.toml", "--rigs", "x", "-o", "y"],
    ):
        assert exit_status(*arguments) == 2
    capsys.readouterr()

"""Statistics, contact sheet and estimate of data sets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import exit_status
from dataset_plans import DEVICE, PLAN, digests

from clradar.dataset import make_sample, recipe, run
from clradar.dataset.contact_sheet import contact_sheet
from clradar.dataset.folder import CONTACT_SHEET
from clradar.dataset.shards import arrays_of
from clradar.dataset.trial import estimate

SIZE_SHARE = 0.25
"""How far the estimate of bytes may be off: samples compress differently."""


def test_there_is_a_contact_sheet(made: Path) -> None:
    from PIL import Image

    with Image.open(made / CONTACT_SHEET) as sheet:
        width, height = sheet.size
        colours = len(np.unique(np.asarray(sheet).reshape(-1, 4), axis=0))
    assert width > 2.5 * height  # five in a row
    assert colours > 100


@pytest.mark.parametrize("products", [["volume"], ["depth_map"], ["capture"], ["mesh", "joints"]])
def test_every_product_is_drawn_on_contact_sheets(products: list[str]) -> None:
    sample = make_sample({**recipe(PLAN, 2), "output": {"products": products}}, DEVICE)
    assert set(sample.arrays) == set(arrays_of(products))
    axes = contact_sheet([sample]).axes
    assert len(axes) == 1
    drawn = len(axes[0].images) + len(axes[0].lines)
    assert drawn == (5 if products == ["mesh", "joints"] else 1)  # a line for each digit


def test_a_contact_sheet_that_was_lost_is_drawn_again(copy: Path) -> None:
    before = digests(copy)
    (copy / CONTACT_SHEET).unlink()
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

"""``clradar image --seeds``: a capture simulated again, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import GRID, Run, one_error_line

import clradar
from clradar.files.hashing import sha256_of
from measurement_io import open_capture, open_volume, save_capture

pytestmark = pytest.mark.filterwarnings("ignore::clradar.ClradarWarning")


@pytest.fixture
def place(made: Path, tmp_path: Path) -> Path:
    """A folder with the capture and its mesh."""
    for name in ("sim.h5", "hand.ply"):
        shutil.copy(made / name, tmp_path / name)
    return tmp_path


def test_the_mean_is_that_of_the_library(run: Run, place: Path) -> None:
    mean, png = place / "mean.h5", place / "band.png"
    outcome = run(
        "image", place / "sim.h5", "--seeds", 2, *GRID, "-o", mean, "--png", png, "--snr-db", 20
    )
    assert outcome.status == 0, outcome.err
    assert "2 seeds: " in outcome.out
    assert "vary (choice of samples and noise)" in outcome.out
    capture, volume = open_capture(place / "sim.h5"), open_volume(mean)
    settings = clradar.SimulationSettings(**capture.meta["settings"])
    found = clradar.spread(
        clradar.Scene.from_mesh(place / "hand.ply", alpha=0.4, unit="m"), capture.array,
        capture.waveform, volume.grid, seeds=2, settings=settings, impairments={"snr_db": 20},
        device="pocl",
    )  # fmt: skip
    np.testing.assert_array_equal(volume.data, found.mean.data)
    assert list(volume.meta["spread"]["seeds"]) == [7, 8]
    digests = {record["file"]: record["sha256"] for record in volume.meta["inputs"]}
    assert digests["hand.ply"] == sha256_of(place / "hand.ply")
    assert png.stat().st_size > 10_000


def test_materials_are_those_of_the_simulation(run: Run, place: Path) -> None:
    palm = place / "palm.h5"
    command = (
        "simulate",
        place / "hand.ply",
        "-o",
        palm,
        "--material",
        "palm",
        "--band",
        "72:82:4",
    )
    assert run(*command, "--samples-per-mm2", 1.5).status == 0
    (place / "hand.ply").rename(place / "moved.ply")
    outcome = run("image", palm, "--seeds", 2, *GRID, "-o", place / "m.h5")
    one_error_line(outcome, "palm.h5: expected the mesh 'hand.ply' beside it, or by --mesh")
    command = ("image", palm, "--seeds", 2, *GRID, "-o", place / "m.h5", "--mesh")
    outcome = run(*command, place / "moved.ply")
    assert outcome.status == 0, outcome.err
    assert "vary (roughness)" in outcome.out


def test_what_is_no_simulation_of_these_meshes_is_refused(run: Run, place: Path) -> None:
    def refused(message: str, *arguments: object) -> None:
        outcome = run("image", *arguments, "-o", place / "x.h5")
        one_error_line(outcome, message)
        assert not (place / "x.h5").exists()

    sim = place / "sim.h5"
    with open(place / "hand.ply", "ab") as file:
        file.write(b" ")
    refused("the mesh 'hand.ply' that", sim, "--seeds", 2, *GRID)
    two = ("--mesh", place / "hand.ply", "--mesh", place / "hand.ply")
    refused("expected 1 meshes by --mesh, got 2", sim, "--seeds", 2, *two, *GRID)
    given = open_capture(sim)
    save_capture(place / "own.h5", clradar.Capture(given.data, given.array, given.waveform))
    refused("expected a capture of `clradar simulate`", place / "own.h5", "--seeds", 2, *GRID)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--mesh", "hand.ply"), "together with --seeds"),
        (("--seeds", 2, "--report", "r.html"), "of a single image"),
        (("--seeds", 2, "--method", "sparse"), "expected back-projection over"),
    ],
)
def test_options_that_do_not_go_together(
    run: Run, place: Path, arguments: tuple[object, ...], message: str
) -> None:
    outcome = run("image", place / "sim.h5", *arguments, "--png", place / "x.png")
    assert outcome.status == 2
    assert message in " ".join(outcome.err.split())


def test_a_volume_has_no_seeds(run: Run, made: Path, tmp_path: Path) -> None:
    outcome = run("image", made / "volume.h5", "--seeds", 2, "--png", tmp_path / "x.png")
    assert outcome.status == 2
    assert "--seeds" in outcome.err

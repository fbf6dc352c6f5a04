"""Numbers that no radar has end in one line that names the option, and the unit that was meant."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import Run

MANY = 20 * "9"

SIMULATE = {
    "--samples-per-mm2=1e308": "fewer than 2^31 samples",
    f"--samples-per-mm2={MANY}": "fewer than 2^31 samples",
    f"--band=72:82:{MANY}": "[1, 10000000]",
    "--band=72:82:1000000000000": "[1, 10000000]",
    f"--rays-per-sample={MANY}": "[1, 65536]",
    f"--seed={MANY}": "seed",
    "--band=1e-320:82:9": "from 0.1 to 1000 GHz, got 9.99989e-321 GHz",
    "--band=72e9:82:9": "got 7.2e+10 GHz; did you mean 7.2e+10 Hz (72 GHz)?",
    "--band=72:82000:9": "got 82000 GHz; did you mean 82000 MHz (82 GHz)?",
    "--band=72:1e308:9": "from 0.1 to 1000 GHz, got 1e+308 GHz",
    "--band=72:nan:9": "expected FIRST:LAST:STEPS",
    "--reception-radius-mm=0.01": "from 0.1 to 1000 mm, got 0.01 mm",
    "--reception-radius-mm=1e-320": "from 0.1 to 1000 mm",
    "--reception-radius-mm=1e308": "from 0.1 to 1000 mm",
    "--pattern-exponent=1e308": "at most 10000",
    "--crease-deg=1e308": "[0, 180]",
}

GRID = {
    "--x-mm=0:100:1e-320": "a step from 0.01 to 100000 mm, got 9.99989e-321 mm",
    "--x-mm=-0.1:0.1:0.001": "did you mean 0.001 cm (0.01 mm) or 0.001 m (1 mm)?",
    "--y-mm=0:1e308:1": "of at most 100000 mm, got 1e+308 mm",
    "--z-mm=-1e308:1e308:1": "of at most 100000 mm, got 1e+308 mm",
    "--z-mm=0:1e5:0.01": "at most 2147483647 voxels",
    "--z-mm=300000": "of at most 100000 mm, got 300000 mm",
    "--z-mm=nan:1:1": "FIRST:LAST:STEP",
}


@pytest.mark.parametrize("command", ["simulate", "image"])
def test_a_value_out_of_all_bounds_is_one_line_that_names_it(
    command: str, run: Run, made: Path, tmp_path: Path
) -> None:
    source, values = {"simulate": ("hand.ply", SIMULATE), "image": ("sim.h5", GRID)}[command]
    for option, part in values.items():
        outcome = run(command, made / source, "-o", tmp_path / "x.h5", option,
                      *(["--amplitude=spreading"] if "exponent" in option else []))  # fmt: skip
        assert outcome.status in (1, 2), option
        lines = outcome.err.splitlines()
        assert part in lines[-1], (option, outcome.err)
        assert "unexpected" not in outcome.err
        assert len(lines) == 1 if outcome.status == 1 else "Invalid value for" in lines[-1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--distance-mm=1e308"], "a distance from 0.001 to 100 m"),
        (["--distance-mm=0.3"], "got 0.0003 m; did you mean 0.3 m?"),
        (["--distance-mm=300", "--noisy-db=1e308"], "noisy_db: expected at most 300 dB"),
        (["--distance-mm=300", f"--dead-db={MANY}"], "dead_db: expected at most 300 dB"),
        (["--target=sphere", "--radius-mm=1e-320", "--position-mm=0,0,300"], "a radius from"),
        (
            ["--target=sphere", "--radius-mm=20", "--position-mm=1e308,0,300"],
            "coordinates of at most 100 m",
        ),
        (["--target=corner", "--position-mm=0,0,300000"], "did you mean 300 mm (0.3 m)"),
    ],
)
def test_targets_out_of_all_bounds_are_refused(
    options: list[str], part: str, run: Run, made: Path, tmp_path: Path
) -> None:
    if not options[0].startswith("--target"):
        options = ["--target=plate", *options]
    outcome = run("channels", made / "sim.h5", "-o", tmp_path / "c.h5", *options)
    assert outcome.status == 1
    (line,) = outcome.err.splitlines()
    assert part in line
    assert line.startswith("clradar: error: ")
    assert "unexpected" not in line


def test_an_expected_position_is_within_range(run: Run, made: Path) -> None:
    outcome = run("diagnose", made / "sim.h5", "--expect-mm=1e308,0,300")
    (line,) = outcome.err.splitlines()
    assert "expected_m: expected coordinates of at most 100 m" in line


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--center-mm", "1e308", "0", "0"], "center_m: expected coordinates of at most 100 m"),
        (["--center-mm", "300000", "0", "0"], "got 300 m; did you mean 300 mm (0.3 m)"),
        (["--turn-deg=1e308"], "from -360 to 360 degrees"),
        (["--turn-deg=nan"], "from -360 to 360 degrees"),
        (["--edge-mm=1e308"], "edge_length_m"),
        (["--girth=1e-320"], "girth"),
    ],
)
def test_a_hand_is_where_and_as_large_as_hands_are(
    options: list[str], part: str, run: Run, tmp_path: Path
) -> None:
    outcome = run("hand", "F", "-o", tmp_path / "h.ply", *options)
    assert outcome.status in (1, 2)
    assert part in outcome.err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_a_starved_simulation_is_warned_of(run: Run, made: Path, tmp_path: Path) -> None:
    outcome = run("simulate", made / "hand.ply", "-o", tmp_path / "s.h5",
                  "--samples-per-mm2=0.01", "--estimator=stochastic", "--band=72:82:2")  # fmt: skip
    assert outcome.status == 0
    (line,) = outcome.err.splitlines()
    assert line.startswith("clradar: warning: ")
    assert "pairs of antennas received no ray" in line

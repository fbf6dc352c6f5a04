"""The benchmark of letters: which start its fits prefer, and what its table counts."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from calibration.hand_fit.learned_start import Prediction
from clradar.hand import LETTERS, POSES

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import which_letter


def fit(deviance: float, at_mm: float = 0.0) -> dict[str, Any]:
    return {"deviance": deviance, "at_mm": [[at_mm, 0.0, 0.0]] * 5, "time_s": 1.0}


def record(letter: str, **coarse: float) -> dict[str, Any]:
    """A case with these deviances of coarse fits, which the model takes for an A."""
    return {
        "number": 7,
        "letter": letter,
        "coarse": {name: fit(deviance) for name, deviance in coarse.items()},
        "whole": {},
        "scores": {name: 0.9 if name == "A" else -0.1 for name in LETTERS},
        "tried": list(coarse),
    }


def test_the_least_deviance_counts_less_twice_the_logarithm_of_the_probability() -> None:
    case = record("A", A=105.0, E=103.0)
    assert which_letter.best(case) == "E"
    known = which_letter.probabilities(case["scores"])
    assert sum(known.values()) == pytest.approx(1.0)
    # A is 90 times as likely as any other letter: 9 units of deviance.
    assert which_letter.best(case, known) == "A"
    case["coarse"]["A"] = {"failure": "could not fit the hand", "time_s": 1.0}
    assert which_letter.best(case, known) == "E"
    case["coarse"]["E"] = case["coarse"]["A"]
    assert which_letter.best(case) is None


def test_the_table_counts_letters_and_missed_searches() -> None:
    near, far = record("A", A=101.0, E=110.0), record("E", A=105.0, E=104.0)
    near["whole"] = {"truth": fit(100.0), which_letter.LETTER: fit(101.0, 3.0)}
    far["whole"] = {
        "truth": fit(100.0),
        which_letter.LETTER: fit(104.0, 20.0),
        which_letter.MODEL: fit(100.0, 20.0),
    }
    rows = [line.rsplit(maxsplit=3) for line in which_letter.table([near, far]).splitlines()]
    counts = {what.strip(): (int(right), int(all_)) for what, right, _, all_ in rows}
    assert counts["letter: by the model"] == (1, 2)
    assert counts["among its first 2"] == (2, 2)
    assert counts["letter: by coarse fits of these 2"] == (2, 2)
    assert counts["letter: by both"] == (1, 2)  # 1 unit of deviance is less than 9
    # Far off, and 4 worse than the truth; from the model as good as the truth.
    assert counts["search missed, from the letter"] == (1, 2)
    assert counts["search missed, from the model"] == (0, 1)
    assert which_letter.line(near).startswith("  7 A: A 101 (1 s) E 110 (1 s) truth 100 (1 s)")
    assert which_letter.table([]) == "no case is around a letter"


def test_the_confusion_matrix_has_the_letter_in_its_row() -> None:
    found = Prediction(POSES["A"], {name: float(name == "E") for name in LETTERS})
    counts = which_letter.confusion_counts(["A", "E", "E"], [found] * 3)
    assert counts.sum() == 3
    assert counts[LETTERS.index("A"), LETTERS.index("E")] == 1
    assert counts[LETTERS.index("E"), LETTERS.index("E")] == 2

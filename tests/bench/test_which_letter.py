"""The benchmark of letters: which start its fits prefer, and what its table counts."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from clradar.hand import LETTERS

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import which_letter
from letter_confusion import confusion_counts, confusion_figure


def fit(deviance: float, at_mm: float = 0.0) -> dict[str, Any]:
    return {"deviance": deviance, "at_mm": [[at_mm, 0.0, 0.0]] * 5, "time_s": 1.0}


def record(letter: str, **coarse: float) -> dict[str, Any]:
    """A case with these deviances of coarse fits, which the model takes for an A."""
    return {
        "number": 7,
        "letter": letter,
        "coarse": {name: fit(deviance) for name, deviance in coarse.items()},
        "ended": {},
        "whole": {},
        "scores": {name: 0.9 if name == "A" else -0.1 for name in LETTERS},
        "tried": list(coarse),
    }


def test_the_least_deviance_counts_with_the_logarithm_of_the_probability() -> None:
    case = record("A", A=105.0, E=103.0)
    assert which_letter.best(case["coarse"], case["tried"]) == ["E", "A"]
    known = which_letter.probabilities(case["scores"])
    assert sum(known.values()) == pytest.approx(1.0)
    # A is 90 times as likely as any other letter, worth 2.3 ln 90 = 10 units of deviance.
    assert which_letter.best(case["coarse"], case["tried"], known) == ["A", "E"]
    assert which_letter.ranked({"A": 114.0, "E": 103.0}, known) == ["E", "A"]
    case["coarse"]["A"] = {"failure": "could not fit the hand", "time_s": 1.0}
    assert which_letter.best(case["coarse"], case["tried"], known) == ["E"]
    case["coarse"]["E"] = case["coarse"]["A"]
    assert which_letter.best(case["coarse"], case["tried"]) == []


def test_every_letter_is_measured_once_and_no_free_pose() -> None:
    chosen = which_letter.numbers(which_letter.FIRST_SEED, 24)
    letters = [which_letter.letter_of(n, which_letter.FIRST_SEED) for n in chosen]
    assert sorted(letters) == sorted(LETTERS)
    assert not any(which_letter.is_free(n) for n in chosen)
    assert which_letter.numbers(which_letter.FIRST_SEED, 2) == chosen[:2]


def test_the_table_counts_letters_and_missed_searches() -> None:
    near, far = record("A", A=101.0, E=110.0), record("E", A=105.0, E=104.0)
    near["whole"] = {"truth": fit(100.0), which_letter.LETTER: fit(101.0, 3.0)}
    near["ended"] = {"deviances": {"E": 95.0, "A": 96.0}}
    far["whole"] = {
        "truth": fit(100.0),
        which_letter.LETTER: fit(104.0, 20.0),
        which_letter.MODEL: fit(100.0, 20.0),
    }
    lines = which_letter.table([near, far]).splitlines()
    taken = [line.strip() for line in lines if "taken: " in line]
    rows = [line.rsplit(maxsplit=3) for line in lines if "taken: " not in line]
    counts = {what.strip(): (int(right), int(all_)) for what, right, _, all_ in rows}
    assert counts["letter by the model"] == (1, 2)
    assert counts["letter by the model, among its first three"] == (2, 2)
    assert counts["letter by coarse fits"] == (2, 2)
    assert counts["letter by coarse fits and model"] == (1, 2)  # 1 unit of deviance is less than 10
    # The second was refused.
    assert counts["letter by fits"] == (0, 2)
    assert counts["letter by fits and model"] == (1, 2)
    assert taken == [
        "taken: E for A", "taken: none for another", "taken: E for A", "taken: A for E, E for none",
        "taken: E for none",
    ]  # fmt: skip
    # Far off, and 4 worse than the truth; from the model as good as the truth.
    assert counts["search missed, from the letter"] == (1, 2)
    assert counts["search missed, from the model"] == (0, 1)
    said = which_letter.line(near)
    assert said.startswith("  7 A: E ends at 95, A ends at 96, A 101 (1 s) E 110 (1 s) truth 100")
    assert which_letter.table([]) == "no case is around a letter"


def test_the_confusion_matrix_has_the_letter_in_its_row() -> None:
    counts = confusion_counts(["A", "E", "E", "L"], ["E", "E", "E", None])
    assert counts.sum() == 3
    assert counts[LETTERS.index("A"), LETTERS.index("E")] == 1
    assert counts[LETTERS.index("E"), LETTERS.index("E")] == 2
    figure = confusion_figure({"by fits": counts, "by both": counts})
    assert [axes.get_xlabel() for axes in figure.axes] == ["by fits", "by both"]

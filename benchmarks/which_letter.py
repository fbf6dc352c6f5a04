"""Which letter a hand shows: by fits, by a learned start, by both; and the searches that one saves.

    python benchmarks/which_letter.py FOLDER start.onnx [--first N] [--cases N] [--search]
    python benchmarks/which_letter.py --unseen pose_letters start.onnx --png confusion.png

The cases are those of `hand_fit_cases.py` that are around a letter, with seeds of their own. The
coarse fits with which `calibration.fit_hand` chooses among starts are made from the likeliest
letters of the model (examples/train_pose.py). With `--search` the whole fit is made from the letter
that a case is around, from the model, and from the truth, which tells what searches miss. FOLDER
keeps the images in `cases` and a JSON record of every case in `letters`: a run that is stopped goes
on where it was. `--unseen` shows the model all samples of a data set that it has not learned from.
"""

from __future__ import annotations

import argparse
import json
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hand_fit import FIT_SEED, errors, from_truth, timed
from hand_fit_cases import Case, is_free, load_case, make_case
from hand_fit_table import missed
from matplotlib.figure import Figure

import clradar
from calibration import LearnedStart, fit_hand
from calibration.hand_fit.basins import roughly
from calibration.hand_fit.descent import HandFitter, fitted_parameters
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.learned_start import Prediction, prediction_of, samples_of
from calibration.hand_fit.placing import placed
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.registration.mesh_pose import depth_for_mesh
from calibration.registration.radar import Radar
from clradar.errors import CompareError
from clradar.hand import LETTERS, POSES
from clradar.hand.shape import AVERAGE
from clradar.plot import save_figure

FIRST_SEED = 83_000
N_CASES = 48
FIRST = 5
SEARCH_DEG = 45.0

LETTER, MODEL, BOTH = "the letter", "the model", "letter and model"
"""Starts of whole fits."""

Record = dict[str, Any]


def probabilities(scores: dict[str, float]) -> dict[str, float]:
    """Least-squares estimates of probabilities can be negative; none is taken for less than 1 %."""
    cut = {letter: max(score, 0.01) for letter, score in scores.items()}
    return {letter: value / sum(cut.values()) for letter, value in cut.items()}


def coarse(case: Case, volume: clradar.Volume, start: str) -> Record:
    """The fit of `calibration.fit_hand` that chooses among several starts."""
    opened = clradar.open_device()
    depth = depth_for_mesh(volume, None)
    aperture = Radar.of("which_letter", None, None).aperture
    model = ParametricHand(case.handedness, opened)
    found = placed(model, POSES[start], AVERAGE, depth, aperture, SEARCH_DEG, opened)
    places = [place for place, _ in found]
    if not places:
        raise CompareError(f"no part of {start} is visible in any pose of the search")
    fitter = HandFitter(model, depth, aperture, opened, fitted_parameters(False))
    prior = Prior.about(places[0], angle_covariance())
    seed = FIT_SEED + case.number
    return {"deviance": roughly(places, fitter, prior, seed, 1).deviance}


def whole(case: Case, volume: clradar.Volume, starts: list[str | LearnedStart]) -> Record:
    found = fit_hand(
        volume,
        starts,
        handedness=case.handedness,
        fit_shape=True,
        closed_loop=False,  # that corrects what was found, and finds nothing
        seed=FIT_SEED + case.number,
    )
    return errors(case, found.joints_m) | {"deviance": found.deviance, "start": found.start}


def run_case(folder: Path, number: int, given: argparse.Namespace, model: LearnedStart) -> Record:
    """Fit what is not in the record of a case yet, which is written after every fit."""
    make_case(folder / "cases", number, given.first_seed)
    case, volume = load_case(folder / "cases", number)
    path = folder / "letters" / f"{number:02d}.json"
    found = model.predict(depth_for_mesh(volume, None), case.handedness)
    record: Record = {"number": number, "coarse": {}, "whole": {}}
    if path.exists():
        record = json.loads(path.read_text())
    record |= {"letter": case.letter, "scores": found.scores}
    record["tried"] = found.letters()[: given.first]
    for letter in record["tried"]:
        if letter not in record["coarse"]:
            record["coarse"][letter] = timed(lambda: coarse(case, volume, letter))  # noqa: B023
            write(path, record)
    for name, fit in {
        LETTER: lambda: whole(case, volume, [case.letter]),
        MODEL: lambda: whole(case, volume, [model]),
        BOTH: lambda: whole(case, volume, [case.letter, model]),
        "truth": lambda: from_truth(case, volume, case.letter),
    }.items():
        if given.search and name not in record["whole"]:
            record["whole"][name] = timed(fit)
            write(path, record)
    write(path, record)
    return record


def line(record: Record) -> str:
    said = [f"{record['number']:3d} {record['letter']}:"]
    for name, fit in {**record["coarse"], **record["whole"]}.items():
        found = f"{fit['deviance']:.0f}" if "deviance" in fit else "-"
        said.append(f"{name} {found} ({fit['time_s']:.0f} s)")
    return " ".join(said)


def write(path: Path, record: Record) -> None:
    part = path.with_suffix(f".{os.getpid()}")
    part.write_text(json.dumps(record, indent=1))
    part.replace(path)


def best(record: Record, prior: dict[str, float] | None = None) -> str | None:
    """The letter whose coarse fit has the least deviance, less twice the log of its probability."""
    fits = {n: record["coarse"][n] for n in record["tried"] if "deviance" in record["coarse"][n]}
    if not fits:
        return None
    return min(
        fits,
        key=lambda n: fits[n]["deviance"] - (0.0 if prior is None else 2.0 * np.log(prior[n])),
    )


def table(records: list[Record]) -> str:
    """Shares of letters that are right, and of searches that missed."""
    if not records:
        return "no case is around a letter"

    def share(name: str, right: list[bool]) -> str:
        return f"{name:46s}{sum(right):4d} of {len(right)}"

    def share_right(name: str, guess: Callable[[Record], str | None]) -> str:
        return share(name, [guess(record) == record["letter"] for record in records])

    among = len(records[0]["tried"])
    lines = [
        share_right("letter: by the model", lambda r: r["tried"][0]),
        share(f"  among its first {among}", [r["letter"] in r["tried"] for r in records]),
        share_right(f"letter: by coarse fits of these {among}", best),
        share_right("letter: by both", lambda r: best(r, probabilities(r["scores"]))),
    ]
    for name in (LETTER, MODEL, BOTH):
        lost = [missed({"fit": r["whole"].get(name, {}), **r["whole"]}) for r in records]
        lines.append(share(f"search missed, from {name}", [one for one in lost if one is not None]))
    return "\n".join(lines)


def unseen(folder: Path, model: LearnedStart, png: Path | None) -> str:
    """How many letters of the samples of a data set the model has right that it was not taught."""
    inputs, outputs, kept = samples_of(clradar.open_dataset(folder))
    true = [prediction_of(row).letters()[0] for row in outputs[kept]]
    found = [model.predict_picture(picture) for picture in inputs[kept]]
    if png is not None:
        save_figure(confusion_figure(confusion_counts(true, found)), png, force=True)
    lines = []
    for among in (1, 3, 5):
        right = sum(a in b.letters()[:among] for a, b in zip(true, found, strict=True))
        lines.append(f"among the model's first {among}: {right} of {len(true)}")
    return "\n".join(lines)


def confusion_counts(true: list[str], found: list[Prediction]) -> np.ndarray:
    """How often a letter, the row, is taken for another, the column."""
    counts = np.zeros((len(LETTERS), len(LETTERS)), int)
    for letter, prediction in zip(true, found, strict=True):
        counts[LETTERS.index(letter), LETTERS.index(prediction.letters()[0])] += 1
    return counts


def confusion_figure(counts: np.ndarray) -> Figure:
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    axes = figure.subplots()
    axes.imshow(counts, cmap="Blues")
    for (row, column), value in np.ndenumerate(counts):
        if value:
            dark = value > 0.6 * counts.max()
            axes.text(
                column, row, value, ha="center", va="center", size=7, color="w" if dark else "k"
            )
    axes.set_xticks(range(len(LETTERS)), LETTERS)
    axes.set_yticks(range(len(LETTERS)), LETTERS)
    axes.set_xlabel("likeliest letter")
    axes.set_ylabel("letter")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the cases, or with --unseen a data set")
    parser.add_argument("model", type=Path)
    parser.add_argument("--unseen", action="store_true", help="the samples of a data set")
    parser.add_argument("--png", type=Path, help="confusion matrix of these samples")
    parser.add_argument("--cases", type=int, default=N_CASES)
    parser.add_argument("--first", type=int, default=FIRST, help="letters to fit, 24 for all")
    parser.add_argument("--search", action="store_true", help="make whole fits, too")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    given = parser.parse_args()
    model = LearnedStart.read(given.model)
    warnings.simplefilter("ignore", clradar.ClradarWarning)
    if given.unseen:
        print(unseen(given.folder, model, given.png))
        return
    for name in ("cases", "letters"):
        (given.folder / name).mkdir(parents=True, exist_ok=True)
    records = []
    for number in range(given.cases):
        if not is_free(number):
            records.append(run_case(given.folder, number, given, model))
            print(line(records[-1]), flush=True)
    print(table(records))


if __name__ == "__main__":
    main()

"""Which letter a hand shows: by fits, by a learned start, by both; and the searches that one saves.

    python benchmarks/which_letter.py FOLDER start.onnx [--workers 2] [--png letters.png] [--search]
    python benchmarks/which_letter.py --unseen pose_letters start.onnx --png confusion.png

The cases are those of `hand_fit_cases.py` that are around a letter, every letter once, with seeds
of their own. Every letter is fitted as `calibration.fit_hand(volume, "all", closed_loop=False)`
does: coarsely, and the best three to the end. The model (examples/train_pose.py) says which letters
are likely. With `--search` the whole fit is made from the letter that a case is around, from the
model, and from the truth, which tells what searches miss. FOLDER keeps the images in `cases` and a
JSON record of every case in `letters`: a run that is stopped goes on where it was. `--unseen` shows
the model all samples of a data set that it has not learned from.
"""

from __future__ import annotations

import argparse
import json
import os
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import count, islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from hand_fit import FIT_SEED, errors, from_truth, timed
from hand_fit_cases import Case, is_free, letter_of, load_case, make_case
from hand_fit_table import missed
from letter_confusion import confusion_counts, confusion_figure

import clradar
from calibration import LearnedStart, fit_hand
from calibration.hand_fit.basins import roughly
from calibration.hand_fit.certainty import DEVIANCE_PER_E
from calibration.hand_fit.descent import HandFitter, fitted_parameters
from calibration.hand_fit.fit_hand import SEARCHED, TRIED_OF_SEVERAL
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.learned_start import prediction_of, samples_of
from calibration.hand_fit.placing import placed
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.registration.mesh_pose import depth_for_mesh
from calibration.registration.radar import Radar
from clradar.errors import CompareError
from clradar.hand import LETTERS, POSES
from clradar.hand.shape import AVERAGE
from clradar.plot import save_figure

FIRST_SEED = 83_000
SEARCH_DEG = 45.0

LETTER, MODEL, BOTH = "the letter", "the model", "letter and model"
"""Starts of whole fits."""

Record = dict[str, Any]


def probabilities(scores: dict[str, float]) -> dict[str, float]:
    """Least-squares estimates of probabilities can be negative; none is taken for less than 1 %."""
    cut = {letter: max(score, 0.01) for letter, score in scores.items()}
    return {letter: value / sum(cut.values()) for letter, value in cut.items()}


def numbers(first_seed: int, n: int) -> list[int]:
    """Of the first cases that are around a letter, `n`, with each letter as often as any other."""
    most = -(-n // len(LETTERS))
    taken: Counter[str] = Counter()

    def chosen() -> Iterator[int]:
        for number in count():
            letter = letter_of(number, first_seed)
            if not is_free(number) and taken[letter] < most:
                taken[letter] += 1
                yield number

    return list(islice(chosen(), n))


def coarse(case: Case, volume: clradar.Volume, start: str) -> Record:
    """The fit of `calibration.fit_hand` that chooses among several starts."""
    opened = clradar.open_device()
    depth = depth_for_mesh(volume, None)
    aperture = Radar.of("which_letter", None, None).aperture
    model = ParametricHand(case.handedness, opened)
    found = placed(
        model, POSES[start], AVERAGE, depth, aperture, SEARCH_DEG, opened, tried=TRIED_OF_SEVERAL
    )
    places = [place for place, _ in found]
    if not places:
        raise CompareError(f"no part of {start} is visible in any pose of the search")
    fitter = HandFitter(model, depth, aperture, opened, fitted_parameters(False))
    prior = Prior.about(places[0], angle_covariance())
    seed = FIT_SEED + case.number
    return {"deviance": roughly(places, fitter, prior, seed, 1).deviance}


def ended(case: Case, volume: clradar.Volume, letters: list[str]) -> Record:
    """The fits to the end from the best letters, and the least deviance that each came to."""
    seed = FIT_SEED + case.number
    found = fit_hand(volume, letters, handedness=case.handedness, closed_loop=False, seed=seed)
    least: dict[str, float] = {}
    for basin in found.basins:  # the best first
        least.setdefault(basin.start, basin.deviance)
    return {"deviances": least}


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


def run_case(number: int, given: argparse.Namespace) -> Record:
    """Fit what is not in the record of a case yet, which is written after every fit."""
    warnings.simplefilter("ignore", clradar.ClradarWarning)
    folder, model = given.folder, LearnedStart.read(given.model)
    make_case(folder / "cases", number, given.first_seed)
    case, volume = load_case(folder / "cases", number)
    path = folder / "letters" / f"{number:02d}.json"
    found = model.predict(depth_for_mesh(volume, None), case.handedness)
    record: Record = {"number": number, "coarse": {}, "ended": {}, "whole": {}}
    if path.exists():
        record = json.loads(path.read_text())
    record |= {"letter": case.letter, "scores": found.scores}
    record["tried"] = found.letters()[: given.first]
    for letter in record["tried"]:
        if letter not in record["coarse"]:
            record["coarse"][letter] = timed(lambda: coarse(case, volume, letter))  # noqa: B023
            write(path, record)
    last = best(record["coarse"], record["tried"])[:SEARCHED]
    if last and set(last) != set(record.get("ended_from", [])):
        record |= {"ended_from": last, "ended": timed(lambda: ended(case, volume, last))}
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
    ends = record["ended"].get("deviances", {})
    said += [f"{letter} ends at {deviance:.0f}," for letter, deviance in ends.items()]
    for name, fit in {**record["coarse"], **record["whole"]}.items():
        found = f"{fit['deviance']:.0f}" if "deviance" in fit else "-"
        said.append(f"{name} {found} ({fit['time_s']:.0f} s)")
    return " ".join(said)


def write(path: Path, record: Record) -> None:
    part = path.with_suffix(f".{os.getpid()}")
    part.write_text(json.dumps(record, indent=1))
    part.replace(path)


def best(
    coarse_fits: Record, letters: list[str], prior: dict[str, float] | None = None
) -> list[str]:
    """Letters whose coarse fits found something, that of the least deviance first."""
    known = {n: coarse_fits[n]["deviance"] for n in letters if "deviance" in coarse_fits[n]}
    return ranked(known, prior)


def ranked(deviances: dict[str, float], prior: dict[str, float] | None = None) -> list[str]:
    """Letters, the likeliest first: by the deviances of their fits, and by what was known before.

    A deviance that is larger by `DEVIANCE_PER_E` makes a pose 1 / e times as likely, as for the
    standard deviations of a fit: the weight of the probability's logarithm is no choice of the
    benchmark.
    """

    def cost(letter: str) -> float:
        known = 0.0 if prior is None else DEVIANCE_PER_E * float(np.log(prior[letter]))
        return deviances[letter] - known

    return sorted(deviances, key=cost)


GUESSES: dict[str, Callable[[Record], list[str]]] = {
    "the model": lambda r: r["tried"],
    "coarse fits": lambda r: best(r["coarse"], r["tried"]),
    "coarse fits and model": lambda r: best(r["coarse"], r["tried"], probabilities(r["scores"])),
    "fits": lambda r: ranked(r["ended"].get("deviances", {})),
    "fits and model": lambda r: ranked(r["ended"].get("deviances", {}), probabilities(r["scores"])),
}
"""Ways to the letter of a case: letters in the order of their likelihood, none where all failed."""


def table(records: list[Record]) -> str:
    """Shares of letters that are right, and of searches that missed."""
    if not records:
        return "no case is around a letter"

    def share(name: str, right: list[bool]) -> str:
        return f"{name:55s}{sum(right):4d} of {len(right)}"

    true = [r["letter"] for r in records]
    lines = []
    for name, guess in GUESSES.items():
        found = [guess(r) for r in records]
        for most, words in ((1, ""), (3, ", among its first three")):
            right = [one in letters[:most] for one, letters in zip(true, found, strict=True)]
            lines.append(share(f"letter by {name}{words}", right))
        wrong = [
            f"{one} for {letters[0] if letters else 'none'}"
            for one, letters in zip(true, found, strict=True)
            if letters[:1] != [one]
        ]
        lines.append(f"  taken: {', '.join(wrong) or 'none for another'}")
    for name in (LETTER, MODEL, BOTH):
        lost = [missed({"fit": r["whole"].get(name, {}), **r["whole"]}) for r in records]
        known = [one for one in lost if one is not None]
        if known:
            lines.append(share(f"search missed, from {name}", known))
    return "\n".join(lines)


def unseen(folder: Path, model: LearnedStart, png: Path | None) -> str:
    """How many letters of the samples of a data set the model has right that it was not taught."""
    inputs, outputs, kept = samples_of(clradar.open_dataset(folder))
    true = [prediction_of(row).letters()[0] for row in outputs[kept]]
    found = [model.predict_picture(picture) for picture in inputs[kept]]
    if png is not None:
        counts = confusion_counts(true, [one.letters()[0] for one in found])
        save_figure(confusion_figure({"likeliest letter": counts}), png, force=True)
    lines = []
    for among in (1, 3, 5):
        right = sum(a in b.letters()[:among] for a, b in zip(true, found, strict=True))
        lines.append(f"among the model's first {among}: {right} of {len(true)}")
    return "\n".join(lines)


def pictured(records: list[Record], png: Path) -> None:
    """Draw the confusion matrices of the model, the fits, and both."""
    true = [r["letter"] for r in records]
    shown = {
        f"by {name}": confusion_counts(true, [next(iter(GUESSES[name](r)), None) for r in records])
        for name in ("the model", "fits", "fits and model")
    }
    save_figure(confusion_figure(shown), png, force=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the cases, or with --unseen a data set")
    parser.add_argument("model", type=Path)
    parser.add_argument("--unseen", action="store_true", help="the samples of a data set")
    parser.add_argument("--png", type=Path, help="confusion matrices")
    parser.add_argument("--cases", type=int, default=len(LETTERS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument(
        "--first", type=int, default=len(LETTERS), help="fit only so many letters of the model's"
    )
    parser.add_argument("--search", action="store_true", help="make whole fits, too")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    given = parser.parse_args()
    if given.unseen:
        warnings.simplefilter("ignore", clradar.ClradarWarning)
        print(unseen(given.folder, LearnedStart.read(given.model), given.png))
        return
    for name in ("cases", "letters"):
        (given.folder / name).mkdir(parents=True, exist_ok=True)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the workers, which are started afresh
    records = []
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
        chosen = numbers(given.first_seed, given.cases)
        for done in as_completed([pool.submit(run_case, n, given) for n in chosen]):
            records.append(done.result())
            print(line(records[-1]), flush=True)
    records.sort(key=lambda record: record["number"])
    print(table(records))
    if given.png is not None:
        pictured(records, given.png)


if __name__ == "__main__":
    main()

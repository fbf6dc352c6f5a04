"""Results are those that are on file: to the last bit on the same machine, closely on others."""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import results_digests as digests

import clradar

# Few rays and rounds give reasons to doubt the results, which are compared all the same.
pytestmark = pytest.mark.filterwarnings("ignore::clradar.ClradarWarning")

FILE = Path(__file__).with_name("results_digests.json")
"""Made by `python tests/results_digests.py --write tests/results_digests.json`."""

FEWEST = 250
"""Numerical results that any machine can compare; there are some more."""

Document = dict[str, Any]


@pytest.fixture(scope="module")
def on_file() -> Document:
    return json.loads(FILE.read_text())


@pytest.fixture(scope="module")
def made() -> Document:
    """What this machine computes, without the case that takes half of the time."""
    return digests.document(clradar.open_device("pocl"), cheap=True)


def elsewhere(document: Document) -> Document:
    """Return a document as if another machine had made it."""
    changed = copy.deepcopy(document)
    changed["environment"]["processor"] = "another"
    return changed


@pytest.mark.device
def test_results_stay(on_file: Document, made: Document) -> None:
    # Bits of the host depend on threads of libraries, which other tests of a process may have set.
    if "PYTEST_XDIST_WORKER" in os.environ:
        made = elsewhere(made)
    compared = digests.compare(on_file, made)
    assert compared.lines == ()
    # All that was computed was compared, in one way or the other.
    results = [result for case in made["results"].values() for result in case.values()]
    numbers = sum("fingerprint" in result for result in results)
    assert numbers >= FEWEST
    if on_file["environment"] != made["environment"]:
        assert (compared.by_bits, compared.by_fingerprint) == (0, numbers)
    elif on_file["clradar"] != made["clradar"]:
        assert (compared.by_bits, compared.by_fingerprint) == (numbers, 0)
    else:
        assert (compared.by_bits, compared.by_fingerprint) == (len(results), 0)


@pytest.mark.device
def test_other_machines_compare_fingerprints(on_file: Document, made: Document) -> None:
    """Also where this machine compares bits."""
    compared = digests.compare(on_file, elsewhere(made))
    assert compared.lines == ()
    assert compared.by_fingerprint >= FEWEST


@pytest.mark.device
def test_every_case_is_on_file(on_file: Document, made: Document) -> None:
    assert set(on_file["results"]) == set(digests.CASES)
    assert set(made["results"]) == {name for name, case in digests.CASES.items() if case.cheap}
    assert all(on_file["results"].values())


# The comparison itself


RNG = np.random.default_rng(0)
IMAGE = (RNG.standard_normal((8, 9)) + 1j * RNG.standard_normal((8, 9))).astype(np.complex64)


def document_of(image: np.ndarray, text: bytes = b"text", tolerance: float = 1e-4) -> Document:
    results = {"image": digests.Result(image, tolerance), "text": digests.Result(text, None)}
    return {
        "environment": {"processor": "one"},
        "clradar": "1",
        "results": {"case": {name: result.record() for name, result in results.items()}},
    }


def changed_by(share: float) -> np.ndarray:
    """Return the image plus noise of this share of its norm."""
    noise = np.random.default_rng(1).standard_normal(IMAGE.shape)
    norm = np.linalg.norm(IMAGE)
    return (IMAGE + share * norm * noise / np.linalg.norm(noise)).astype(np.complex64)


def test_a_bit_counts_on_the_same_machine() -> None:
    one = IMAGE.copy()
    one.view(np.uint32)[0, 0] ^= 1
    before = document_of(IMAGE)
    assert digests.compare(before, document_of(IMAGE)) == digests.Comparison(2, 0, ())
    (line,) = digests.compare(before, document_of(one)).lines
    assert line == "case/image: other bits, by some 1e-09 of the whole at most"
    (line,) = digests.compare(before, document_of(IMAGE, b"other")).lines
    assert line == "case/text: other bits"
    # The same bytes of another type or shape are another result.
    for other in (IMAGE.view(np.int64), IMAGE.reshape(9, 8)):
        assert len(digests.compare(before, document_of(other)).lines) == 1


def test_elsewhere_the_tolerance_counts() -> None:
    before = document_of(IMAGE)
    close = digests.compare(before, elsewhere(document_of(changed_by(5e-5), b"other")))
    assert close == digests.Comparison(0, 1, ())
    for share in (1e-3, 1.0):
        (line,) = digests.compare(before, elsewhere(document_of(changed_by(share)))).lines
        assert line.startswith("case/image: ")
        assert line.endswith("; tolerance 0.0001")
    holes = IMAGE.real.copy()
    holes[0, :3] = np.nan
    before = document_of(IMAGE.real, tolerance=0.02)
    assert digests.compare(before, elsewhere(document_of(holes))).lines == (
        "case/image: 0 of 72 values NaN, now 3; tolerance 0.02",
    )
    assert "shape" in digests.compare(before, elsewhere(document_of(IMAGE[:4]))).lines[0]


def test_files_name_the_version_that_made_them() -> None:
    later = document_of(IMAGE, b"made by 2")
    later["clradar"] = "2"
    assert digests.compare(document_of(IMAGE), later) == digests.Comparison(1, 0, ())
    later["results"]["case"]["image"] = document_of(changed_by(1e-5))["results"]["case"]["image"]
    assert len(digests.compare(document_of(IMAGE), later).lines) == 1


def test_results_that_come_or_go_are_differences() -> None:
    whole, part = document_of(IMAGE), document_of(IMAGE)
    del part["results"]["case"]["text"]
    assert digests.compare(whole, part).lines == ("case/text: is not there any more",)
    assert digests.compare(part, whole).lines == ("case/text: was not there before",)
    assert len(digests.compare({**whole, "results": {}}, whole).lines) == 2


@pytest.mark.device
def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is written compares equal; a change is one line and status 1."""
    path = tmp_path / "digests.json"
    assert digests.main(["--write", str(path), "--only", "channels", "room"]) == 0
    assert digests.main(["--compare", str(path), "--only", "channels", "room"]) == 0
    assert "compared by their bits, 0 by their fingerprints, 0 differ" in capsys.readouterr().out
    changed = json.loads(path.read_text())
    changed["results"]["channels"]["reference"]["sha256"] = "0"
    path.write_text(json.dumps(changed))
    assert digests.main(["--compare", str(path), "--only", "channels"]) == 1
    out = capsys.readouterr().out.splitlines()
    assert [line for line in out if "other bits" in line] == [
        "channels/reference: other bits, by some 1e-09 of the whole at most"
    ]
    # Another machine that has only texts to compare has compared nothing.
    changed["results"]["channels"] = {}
    monkeypatch.setitem(digests.CASES, "channels", _without_results())
    path.write_text(json.dumps(changed))
    assert digests.main(["--compare", str(path), "--only", "channels"]) == 1


def _without_results() -> digests.Case:
    return digests.Case("channels", lambda works: {}, digests.EXACT, True)


def test_a_gain_of_a_few_percent_is_found_elsewhere() -> None:
    """Of a capture of 6912 numbers whose paths may come and go at random."""
    rng = np.random.default_rng(2)
    data, noise = (rng.standard_normal((12, 12, 24, 2)).view(complex)[..., 0] for _ in range(2))
    before = document_of(data, tolerance=digests.TRACED)
    for other, differs in ((data + 0.04 * noise, False), (1.04 * data, True), (0.96 * data, True)):
        found = digests.compare(before, elsewhere(document_of(other, tolerance=digests.TRACED)))
        assert (found.lines != ()) == differs

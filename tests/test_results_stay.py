"""Results are those that are on file: to the last bit on the same machine, closely on others."""

import copy
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import results_digests as digests
from nightly import nightly

import clradar

# Few rays and rounds give reasons to doubt the results, which are compared all the same.
pytestmark = pytest.mark.filterwarnings("ignore::clradar.ClradarWarning")

FILE = Path(__file__).with_name("results_digests.json")
"""Made by `python tests/results_digests.py --write tests/results_digests.json`."""

FEWEST = 250
"""Numerical results of cheap cases that any machine can compare; there are some more."""

Document = dict[str, Any]


@pytest.fixture(scope="module")
def on_file() -> Document:
    return json.loads(FILE.read_text())


def elsewhere(document: Document) -> Document:
    """Return a document as if another machine had made it."""
    changed = copy.deepcopy(document)
    changed["environment"]["processor"] = "another"
    return changed


@pytest.mark.device
@pytest.mark.parametrize("cheap", [True, *nightly([False])])
def test_results_stay(on_file, cheap):
    assert set(on_file["results"]) == set(digests.CASES)
    names = [name for name, case in digests.CASES.items() if case.cheap == cheap]
    made = digests.document(clradar.open_device("pocl"), only=names)
    assert list(made["results"]) == names
    # Bits of the host depend on threads of libraries, which other tests of a process may have set.
    one_process = "PYTEST_XDIST_WORKER" not in os.environ
    for other in [made, elsewhere(made)] if one_process else [elsewhere(made)]:
        compared = digests.compare(on_file, other)
        assert compared.lines == ()
        # All that was computed was compared, in one way or the other.
        assert compared.by_bits + compared.by_fingerprint == sum(map(len, made["results"].values()))
    assert compared.by_fingerprint >= FEWEST or not cheap


# The comparison itself


RNG = np.random.default_rng(0)
IMAGE = (RNG.standard_normal((8, 9)) + 1j * RNG.standard_normal((8, 9))).astype(np.complex64)


def document_of(image: np.ndarray, tolerance: float = 1e-4) -> Document:
    record = digests.Result(image, tolerance).record()
    return {"environment": {"processor": "one"}, "results": {"case": {"image": record}}}


def changed_by(share: float) -> np.ndarray:
    """The image plus noise of this share of its norm."""
    noise = np.random.default_rng(1).standard_normal(IMAGE.shape)
    norm = np.linalg.norm(IMAGE)
    return (IMAGE + share * norm * noise / np.linalg.norm(noise)).astype(np.complex64)


def test_a_bit_counts_on_the_same_machine():
    one = IMAGE.copy()
    one.view(np.uint32)[0, 0] ^= 1
    before = document_of(IMAGE)
    assert digests.compare(before, document_of(IMAGE)) == digests.Comparison(1, 0, ())
    (line,) = digests.compare(before, document_of(one)).lines
    assert line == "case/image: other bits: by some 1e-09 of the whole at most"
    # The same bytes of another type or shape are another result.
    for other in (IMAGE.view(np.int64), IMAGE.reshape(9, 8)):
        assert len(digests.compare(before, document_of(other)).lines) == 1


def test_elsewhere_the_tolerance_counts():
    before = document_of(IMAGE)
    close = digests.compare(before, elsewhere(document_of(changed_by(5e-5))))
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


def test_a_gain_of_a_few_percent_is_found_elsewhere():
    """Of a capture of 6912 numbers whose paths may come and go at random."""
    rng = np.random.default_rng(2)
    data, noise = (rng.standard_normal((12, 12, 24, 2)).view(complex)[..., 0] for _ in range(2))
    before = document_of(data, tolerance=digests.TRACED)
    for other, differs in ((data + 0.04 * noise, False), (1.04 * data, True), (0.96 * data, True)):
        found = digests.compare(before, elsewhere(document_of(other, tolerance=digests.TRACED)))
        assert (found.lines != ()) == differs

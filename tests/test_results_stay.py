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
BIT, HOLES = IMAGE.copy(), IMAGE.real.copy()
BIT.view(np.uint32)[0, 0] ^= 1
HOLES[0, :3] = np.nan
NOISE, CAPTURE, ADDED = (
    RNG.standard_normal((*shape, 2)).view(complex)[..., 0] * np.sqrt(0.5)
    for shape in ((8, 9), (12, 12, 24), (12, 12, 24))
)
"""Of power 1; of a capture of 6912 numbers the paths may come and go at random."""

COMPARED: dict[str, tuple[np.ndarray, np.ndarray, str | None]] = {
    "here: the same": (IMAGE, IMAGE, None),
    "here: a bit": (IMAGE, BIT, "other bits: by some 1e-09 of the whole at most"),
    "here: the bytes as another type": (IMAGE, IMAGE.view(np.int64), "other bits"),
    "elsewhere: within the tolerance": (IMAGE, IMAGE + 5e-5 * NOISE, None),
    "elsewhere: beyond it": (IMAGE, IMAGE + 2e-3 * NOISE, "; tolerance 0.0001"),
    "elsewhere: NaN": (IMAGE.real, HOLES, "0 of 72 values NaN, now 3; tolerance"),
    "elsewhere: a part": (IMAGE, IMAGE[:4], "shape"),
    "elsewhere, traced: noise of 4 %": (CAPTURE, CAPTURE + 0.04 * ADDED, None),
    "elsewhere, traced: a gain of 4 %": (CAPTURE, 1.04 * CAPTURE, "norm"),
}


@pytest.mark.parametrize("name", COMPARED)
def test_results_are_compared_by_bits_here_and_by_tolerances_elsewhere(name):
    def document_of(values: np.ndarray) -> Document:
        record = digests.Result(values, digests.TRACED if "traced" in name else 1e-4).record()
        return {"environment": {"processor": "one"}, "results": {"case": {"image": record}}}

    old, new, words = COMPARED[name]
    here, now = name.startswith("here"), document_of(new.astype(old.dtype, copy=False))
    found = digests.compare(document_of(old), now if here else elsewhere(now))
    assert (found.by_bits, found.by_fingerprint) == (int(here), int(not here))
    assert len(found.lines) == (words is not None)
    assert all(line.startswith("case/image: ") and words in line for line in found.lines)

"""Cases of a table that only `make nightly` tries, beside those that every run tries."""

from collections.abc import Iterable
from typing import Any

import pytest


def nightly(cases: Iterable[Any]) -> list[Any]:
    """For `parametrize`: these cases, marked as slow; several values of one are a tuple."""
    marks = [pytest.mark.slow]
    return [pytest.param(*(c if isinstance(c, tuple) else (c,)), marks=marks) for c in cases]

"""The one class of warnings: where it points to, and how the command line prints it."""

import warnings

import pytest

from clradar import ClradarWarning
from clradar.cli import console
from clradar.errors import handled_warnings, warn

OWN_CODE = "def inner(warn): warn('grid clips')\ndef outer(warn): inner(warn)"


def test_a_warning_points_to_the_line_outside_of_the_packages():
    functions: dict = {"__name__": "calibration.registration.somewhere"}
    exec(compile(OWN_CODE, "somewhere.py", "exec"), functions)
    with pytest.warns(ClradarWarning, match="^grid clips$") as caught:
        functions["outer"](warn)
    assert caught[0].filename == __file__


def test_the_command_line_prints_each_warning_once_on_one_line(capsys):
    with handled_warnings(console.warning):
        for text in ("the grid\nclips", "the grid\nclips", "no echo"):
            warn(text)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["clradar: warning: the grid clips", "clradar: warning: no echo"]


def test_warnings_of_libraries_are_left_to_python():
    with pytest.warns(RuntimeWarning, match="overflow"), handled_warnings(console.warning):
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)

"""Marks for tests of what only some systems have; on Linux all of them run."""

import sys

import pytest

posix_only = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows has no pipes, links, signals or modes as tried here"
)
linux_only = pytest.mark.skipif(
    sys.platform != "linux", reason="inotify, /proc and limits of memory are Linux's"
)

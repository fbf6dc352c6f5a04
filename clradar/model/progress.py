"""The progress callback that long computations take."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with (done, total) units of work, such as samples."""

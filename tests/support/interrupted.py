"""Interrupts of long work, as of a user or, with what they leave, of a kill."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def interrupted_at(
    owner: Any, name: str, nth: int = 1, left: Callable[..., object] = lambda *_: None
) -> Iterator[None]:
    """The nth call of a function is an interrupt, which leaves something behind."""
    function, calls = getattr(owner, name), []

    def until(*args: Any, **options: Any) -> Any:
        calls.append(name)
        if len(calls) == nth:
            left(*args)
            raise KeyboardInterrupt
        return function(*args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, until)
        yield

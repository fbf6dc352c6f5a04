"""Controls of viser: what a user changes becomes an act, what follows the state does not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Controls:
    """The controls of a page.

    Parameters
    ----------
    gui : viser.GuiApi
    """

    def __init__(self, gui: Any) -> None:
        self.gui = gui
        self._acts: list[tuple[Any, Callable[[], None]]] = []

    def on(self, control: Any, act: Callable[[], None]) -> None:
        """Call `act` when a user changes a control."""

        def changed(event: Any) -> None:
            # A value that was set here to follow the state is no wish.
            if event.client is not None:
                act()

        control.on_update(changed)
        self._acts.append((control, act))

    def toggle(self, control: Any) -> None:
        """Change a checkbox as a user does."""
        control.value = not control.value
        next(act for one, act in self._acts if one is control)()

    def key(self, key: str, label: str, act: Callable[[], None]) -> None:
        """Call `act` when a key is pressed."""
        self.gui.add_command(label, hotkey=key).on_trigger(lambda _: act())

    def html(self) -> Any:
        """Return an empty drawing."""
        return self.gui.add_html("")


def assign(control: Any, name: str, value: Any) -> None:
    """Set a property unless it has that value: each assignment is sent to every browser."""
    if getattr(control, name) != value:
        setattr(control, name, value)

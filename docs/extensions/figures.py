"""Pictures of the tutorials: the figures that a block has made, which pyplot does not know."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


class ByNumber:
    """The order of tutorials: 1, …, 7, 7a, …, 10."""

    def __init__(self, src_dir: str) -> None:
        pass

    def __call__(self, name: str) -> tuple[int, str]:
        """Return the number that a file's name begins with, and the rest."""
        digits = len(name) - len(name.lstrip("0123456789"))
        return int(name[:digits]), name[digits:]


class FigureScraper:
    """Saves every `matplotlib.figure.Figure` among a block's names, once."""

    def __init__(self) -> None:
        # Kept, not only their ids: Python gives the id of a forgotten object to the next.
        self.saved: list[Figure] = []

    def __repr__(self) -> str:
        # Part of the configuration: a text that changes with every build would rebuild every page.
        return type(self).__name__

    def __getstate__(self) -> dict[str, Any]:
        # The pages, which are pickled, know the configuration.
        return {"saved": []}

    def __call__(
        self, block: tuple[Any, ...], block_vars: dict[str, Any], gallery_conf: dict[str, Any]
    ) -> str:
        """Return the reStructuredText that shows the new figures of a block."""
        paths = []
        for value in block_vars["example_globals"].values():
            if isinstance(value, Figure) and not any(value is one for one in self.saved):
                self.saved.append(value)
                paths.append(next(block_vars["image_path_iterator"]))
                value.savefig(paths[-1], dpi=100)
        return figure_rst(paths, gallery_conf["src_dir"])

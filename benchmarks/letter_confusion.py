"""Which letters are taken for which: matrices of counts, and their figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from clradar.hand import LETTERS


def confusion_counts(true: Sequence[str], found: Sequence[str | None]) -> np.ndarray:
    """How often a letter, the row, is taken for another, the column; None is in no column."""
    counts = np.zeros((len(LETTERS), len(LETTERS)), int)
    for one, other in zip(true, found, strict=True):
        if other is not None:
            counts[LETTERS.index(one), LETTERS.index(other)] += 1
    return counts


def confusion_figure(shown: dict[str, np.ndarray]) -> Figure:
    """Draw matrices side by side, each with its words below."""
    figure = Figure(figsize=(6.4 * len(shown), 6.0), layout="constrained")
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, (words, counts) in zip(panels, shown.items(), strict=True):
        axes.imshow(counts, cmap="Blues")
        for (row, column), value in np.ndenumerate(counts):
            if value:
                colour = "w" if value > 0.6 * counts.max() else "k"
                axes.text(column, row, value, ha="center", va="center", size=7, color=colour)
        axes.set_xticks(range(len(LETTERS)), LETTERS)
        axes.set_yticks(range(len(LETTERS)), LETTERS)
        axes.set_xlabel(words)
        axes.set_ylabel("letter")
    return figure

"""Which frames of recordings of a moving hand are fitted, and on how many workers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clradar.cli.options.groups import option
from clradar.cli.options.values import wrong_usage
from clradar.errors import ModelError

ALL, RANGE = "all", "FIRST:LAST[:STEP]"
FRAMES_METAVAR = f"all|{RANGE}|N,..."


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """Which frames of recordings of a moving hand, and on how many workers."""

    frames: str | None = option(
        None,
        "Fit a moving hand to these frames of a recording, each from the one before: all, "
        f"{RANGE}, or numbers with commas. The folder resumes.",
        metavar=FRAMES_METAVAR,
    )
    workers: int | None = option(
        None,
        "With --frames: worker processes for several recordings "
        '(pip install "clradar[dataset]"). [default: one for each of several devices, else one '
        "after the other, here]",
        metavar="N",
        min=1,
    )

    def __post_init__(self) -> None:
        if self.frames is None and self.workers is not None:
            raise wrong_usage("--workers", "expected together with --frames")

    def of_frames(self, sources: Sequence[Path]) -> bool:
        """Whether frames of recordings are fitted, and not a single image."""
        if self.frames is None and len(sources) > 1:
            raise wrong_usage("MEASURED", "expected one, or --frames with several recordings")
        return self.frames is not None

    def numbers(self, there: Sequence[int]) -> list[int]:
        """The chosen ones of the frames that are there."""
        return chosen_frames(str(self.frames), there)


def chosen_frames(text: str, there: Sequence[int], option: str = "--frames") -> list[int]:
    """The frames, or what else has numbers, that an option chooses of those that are there."""
    if text.strip() == ALL:
        return list(there)
    try:
        if ":" in text:
            first, last, step = map(int, f"{text}:1".split(":")[:3])
            if step < 1 or text.count(":") > 2:
                raise ValueError
            chosen = [n for n in there if first <= n <= last and (n - first) % step == 0]
        else:
            chosen = sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise wrong_usage(
            option, f"expected all, {RANGE} or numbers with commas, got '{text}'"
        ) from None
    missing = sorted(set(chosen) - set(there))
    if missing or not chosen:
        raise ModelError(
            f"{option}: expected some of the {option[2:]} {there[0]} to {there[-1]}, got '{text}'"
        )
    return chosen

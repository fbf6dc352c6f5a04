"""Options of clutter: the empty room, and a window of range."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from clradar.cli.options.groups import option
from clradar.cli.options.values import finite, numbers, wrong_usage

GATE_RULE = "NEAR:FAR, half path lengths"


@dataclass(frozen=True, kw_only=True)
class EmptyOptions:
    """The capture of the empty room."""

    empty: Path | None = option(None, "The same without the object: subtracted.", metavar="EMPTY")
    scaling: Literal["none", "common", "channel"] = option(
        "none",
        "Multiply EMPTY by complex factors first, for drift: one for all, or one per channel.",
    )

    def __post_init__(self) -> None:
        if self.empty is None and self.scaling != "none":
            raise wrong_usage("--scaling", "expected --empty with it")


@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """A window of range."""

    gate_mm: str | None = option(
        None, f"Keep only echoes from this window: {GATE_RULE}.", metavar="NEAR:FAR"
    )
    edge_mm: float | None = option(
        None,
        "Width of the window's edges, outside it. [default: 4 c / 2B, 60 for 10 GHz]",
        metavar="MM",
    )
    clutter_db: float | None = option(
        None,
        "How much stronger echoes outside the window are than inside. [default: 40]",
        metavar="DB",
    )

    def settings(self) -> dict[str, Any] | None:
        """Settings of `calibration.range_gate`; None without a window."""
        if self.gate_mm is None:
            if self.edge_mm is not None or self.clutter_db is not None:
                raise wrong_usage("--edge-mm, --clutter-db", "expected --gate-mm with it")
            return None
        ends_m = [value / 1e3 for value in numbers(self.gate_mm, ":")]
        if len(ends_m) != 2 or not finite(ends_m) or not 0 <= ends_m[0] < ends_m[1]:
            raise wrong_usage(
                "--gate-mm",
                f"expected {GATE_RULE} in millimetres, 0 <= NEAR < FAR; got '{self.gate_mm}'",
            )
        found = {"near_m": ends_m[0], "far_m": ends_m[1]}
        if self.edge_mm is not None:
            found["edge_m"] = self.edge_mm / 1e3
        if self.clutter_db is not None:
            found["clutter_db"] = self.clutter_db
        return found

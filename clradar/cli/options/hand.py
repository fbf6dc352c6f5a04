"""Size and shape of the hand of this package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from clradar.cli.options.groups import option

if TYPE_CHECKING:
    from clradar import Device
    from clradar.hand import HandMesh, HandPose, HandShape

EDGE_MM = 1.7


@dataclass(frozen=True, kw_only=True)
class ShapeOptions:
    """Size and proportions of the embedded hand."""

    length_mm: float | None = option(
        None, "Wrist crease to middle fingertip. [default: 187.4]", metavar="MM"
    )
    breadth_mm: float | None = option(None, "Across the knuckles. [default: 85.6]", metavar="MM")
    finger_lengths: tuple[float, float, float, float, float] | None = option(
        None,
        "Thumb to little finger, relative to an average hand of this length.",
        metavar="T I M R P",
    )
    girth: float | None = option(
        None, "Thickness, relative to that of an average hand of this breadth."
    )

    @property
    def shape(self) -> HandShape:
        """Length, breadth, finger lengths, girth; an average adult's where not given."""
        from clradar.hand import HandShape

        average = HandShape()
        return HandShape(
            length_m=average.length_m if self.length_mm is None else self.length_mm / 1e3,
            breadth_m=average.breadth_m if self.breadth_mm is None else self.breadth_mm / 1e3,
            finger_lengths=self.finger_lengths or average.finger_lengths,
            girth=average.girth if self.girth is None else self.girth,
        )


@dataclass(frozen=True, kw_only=True)
class EmbeddedHandOptions(ShapeOptions):
    """Size, shape and mesh of the embedded hand."""

    edge_mm: float | None = option(
        None, f"About the length of an edge. [default: {EDGE_MM}]", metavar="MM"
    )
    left: bool = option(False, "A left hand.")

    @property
    def handedness(self) -> str:
        """Which hand it is, right or left."""
        return "left" if self.left else "right"

    def posed(
        self, pose: HandPose, center_m: Sequence[float], device: Device | str | None
    ) -> HandMesh:
        """The surface of the embedded hand in a pose."""
        from clradar.hand import hand_mesh

        return hand_mesh(
            pose,
            edge_length_m=(EDGE_MM if self.edge_mm is None else self.edge_mm) / 1e3,
            handedness=self.handedness,
            center_m=center_m,
            shape=self.shape,
            device=device,
        )

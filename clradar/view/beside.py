"""What is shown beside a measurement: other recordings, or the simulation of a mesh."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import ClassVar, TypeAlias

from clradar.arrays.array_file import array_record
from clradar.model import Capture, Scene
from clradar.model.known_materials import KNOWN
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.simulation import simulate
from clradar.view.sources import Content, Source
from clradar.view.wish import BY_ALPHA, Wish

Second: TypeAlias = tuple[tuple[Hashable, ...], Callable[[Progress], Content]]

MATERIALS = (BY_ALPHA, *KNOWN)

KEPT_CAPTURES = 8
"""Of simulations, 9 MB each for the 94 x 94 imager."""


@dataclass(frozen=True)
class Others:
    """Other captures, volumes or recordings beside a source.

    A recording of as many frames goes along with it; of any other the first frame is shown.
    """

    source: Source
    others: tuple[Source, ...]
    simulates: ClassVar[bool] = False

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(other.name for other in self.others)

    def of(self, wish: Wish, content: Content) -> Second:
        """Return what the second one depends on, and how it is made."""
        other = self.others[wish.other]
        frames, others = self.source.frames(), other.frames()
        along = len(frames) == len(others) and wish.frame in frames
        frame = others[frames.index(wish.frame) if along else 0]
        return (wish.other, frame), lambda _: other.read(frame)


@dataclass(frozen=True)
class Simulation:
    """What the radar of a capture would record of a mesh, by the wish's alpha or material."""

    scene: Scene
    device: Device | None = None
    labels: ClassVar[tuple[str, ...]] = ("simulation",)
    simulates: ClassVar[bool] = True
    _kept: dict[Hashable, Capture] = field(default_factory=dict)
    """The last ones that were used, the newest last."""

    def of(self, wish: Wish, content: Content) -> Second | None:
        """Return what the simulation depends on, and how it is made; None beside this content."""
        if not isinstance(content, Capture):
            return None  # which radar recorded it is not known
        array, waveform = content.array, content.waveform
        surface = wish.alpha if wish.material == BY_ALPHA else wish.material
        key = surface, repr(array_record(array)), waveform.frequencies_hz.tobytes()

        def simulated(progress: Progress) -> Capture:
            capture = self._kept.pop(key, None)
            if capture is None:
                if wish.material == BY_ALPHA:
                    scene, estimator = self.scene.with_alpha(wish.alpha), None
                else:
                    scene, estimator = self.scene.with_material(KNOWN[wish.material]), "physical"
                capture = simulate(
                    scene, array, waveform,
                    estimator=estimator, seed=0, device=self.device, progress=progress,
                )  # fmt: skip
                if len(self._kept) == KEPT_CAPTURES:
                    del self._kept[next(iter(self._kept))]
            self._kept[key] = capture
            return capture

        return key, simulated


Beside: TypeAlias = Others | Simulation
"""A second capture or volume for every frame, one of `labels`, read or simulated."""

"""What is shown beside a measurement: other recordings, or the simulation of a mesh."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

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

KEPT_CAPTURES = 8  # of simulations, 9 MB each for the 94 x 94 imager


@dataclass(frozen=True)
class Beside:
    """A second capture or volume for every frame, one of `labels`, read or simulated.

    `of` says what it depends on, and how it is made; None: there is none beside this content.
    """

    labels: tuple[str, ...]
    of: Callable[[Wish, Content], Second | None]
    simulates: bool = False


def recorded(source: Source, others: Sequence[Source]) -> Beside:
    """Return other captures, volumes or recordings beside a source.

    A recording of as many frames goes along with it; of any other the first frame is shown.
    """

    def of(wish: Wish, content: Content) -> Second:
        other = others[wish.other]
        here, there = source.frames(), other.frames()
        along = len(here) == len(there) and wish.frame in here
        frame = there[here.index(wish.frame) if along else 0]
        return (wish.other, frame), lambda _: other.read(frame)

    return Beside(tuple(other.name for other in others), of)


def simulated(mesh: Scene, device: Device | None = None) -> Beside:
    """Return what a capture's radar would record of a mesh, by the wish's alpha or material."""
    kept: dict[Hashable, Capture] = {}  # the newest last

    def of(wish: Wish, content: Content) -> Second | None:
        if not isinstance(content, Capture):
            return None  # which radar recorded it is not known
        array, waveform = content.array, content.waveform
        surface = wish.alpha if wish.material == BY_ALPHA else wish.material
        key = surface, repr(array_record(array)), waveform.frequencies_hz.tobytes()

        def made(progress: Progress) -> Capture:
            capture = kept.pop(key, None)
            if capture is None:
                if wish.material == BY_ALPHA:
                    scene, estimator = mesh.with_alpha(wish.alpha), None
                else:
                    scene, estimator = mesh.with_material(KNOWN[wish.material]), "physical"
                capture = simulate(
                    scene, array, waveform,
                    estimator=estimator, seed=0, device=device, progress=progress,
                )  # fmt: skip
                if len(kept) == KEPT_CAPTURES:
                    del kept[next(iter(kept))]
            kept[key] = capture
            return capture

        return key, made

    return Beside(("simulation",), of, simulates=True)

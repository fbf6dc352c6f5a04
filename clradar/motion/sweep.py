"""Simulation of one sweep over a scene that moves meanwhile."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ClradarWarning
from clradar.model import AntennaArray, Capture, Scene, Waveform, checks
from clradar.model.progress import Progress
from clradar.model.record import Record
from clradar.motion.instants import MIDDLE, Probes, SweepTiming, planned
from clradar.motion.rigid import BodyInSweep
from clradar.opencl import Device, open_device
from clradar.simulation import simulate
from clradar.tracing.ambiguous import warn_of_ambiguity
from clradar.tracing.settings import SimulationSettings, merged_settings, takes_settings
from clradar.tracing.surface_samples import sampled_as

AMBIGUOUS = "simulate: the scene (is as wide as|reaches to)"
"""How `warn_of_ambiguity` begins: the lobes of some Tx are not those of the array."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MovingScene(Record):
    """Bodies that move, seen together.

    Parameters
    ----------
    bodies : sequence of MovingBody or MovingHand
    finish : callable, optional
        Sets alphas or materials of the scene of all bodies, with the same faces.
    """

    bodies: Sequence[Any]
    finish: Callable[[Scene], Scene] | None = None

    def __post_init__(self) -> None:
        bodies = tuple(checks.several("MovingScene.bodies", self.bodies))
        if not bodies or not all(hasattr(body, "during") for body in bodies):
            checks.fail("MovingScene.bodies", "MovingBody or MovingHand, at least one", bodies)
        self._set(bodies=bodies)

    def at(self, time_s: float) -> Scene:
        """Return the scene at a time, as a sweep without duration sees it."""
        return self.seen([body.during(time_s, time_s) for body in self.bodies], time_s)

    def seen(self, bodies: Sequence[BodyInSweep], time_s: float) -> Scene:
        """Return the scene at a time of the sweep that its bodies are of.

        :meta private:
        """
        scenes = [body.scene(time_s) for body in bodies]
        scene = scenes[0] if len(scenes) == 1 else Scene.combine(scenes)
        return scene if self.finish is None else self.finish(scene)


@takes_settings
def simulate_moving(
    moving: MovingScene,
    array: AntennaArray,
    waveform: Waveform,
    *,
    timing: SweepTiming | None = None,
    start_s: float = 0.0,
    tolerance_db: float = -50.0,
    settings: SimulationSettings | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> Capture:
    """Simulate a capture of a scene that moves while it is recorded (docs/movement.md).

    Every sample is interpolated to its own time from some instants (E15 in docs/equations.md).

    Parameters
    ----------
    moving : MovingScene
    array : AntennaArray
    waveform : Waveform
    timing : SweepTiming, optional
        When samples are recorded. None: `SweepTiming.in_order`, Tx by Tx.
    start_s : float
        When the sweep begins.
    tolerance_db : float
        Largest error of the interpolated phasors of points on the surface, which decides on the
        number of instants; negative. Samples may be off by more where the surface bends, turns away
        or shadows itself.
    settings, device, progress, **fields
        As of `clradar.simulate`; progress counts instants times Tx.

    Returns
    -------
    Capture
        ``meta["movement"]`` has the times, the instants, and the errors of phasors and samples that
        were reached; other entries are of the first instant. A scene that does not move gives the
        bits of ``simulate(moving.at(t), ...)``.

    Examples
    --------
    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(radius=0.02).apply_translation([0, 0, 0.3])
    >>> nearer = clradar.RigidMotion.steady(velocity_m_per_s=(0, 0, -0.5))
    >>> moving = clradar.MovingScene([clradar.MovingBody(clradar.Scene.from_mesh(ball), nearer)])
    >>> timing = clradar.SweepTiming.in_order(2, 3, step_s=1e-3)
    >>> swept = clradar.simulate_moving(moving, capture.array, capture.waveform, timing=timing)
    >>> swept.data.shape, swept.meta["movement"]["sweep_s"]
    ((2, 1, 3), 0.005)
    """
    checks.instance("simulate_moving: moving", moving, MovingScene)
    checks.instance("simulate_moving: array", array, AntennaArray)
    checks.instance("simulate_moving: waveform", waveform, Waveform)
    start_s = checks.real("simulate_moving: start_s", start_s)
    checks.within("simulate_moving: tolerance_db", tolerance_db, -100.0, -1.0, " dB")
    if timing is None:
        timing = SweepTiming.in_order(array.n_tx, waveform.n_freq)
    checks.instance("simulate_moving: timing", timing, SweepTiming)
    wanted = (array.n_tx, array.n_rx, waveform.n_freq)
    if timing.times_s.shape not in (wanted, (wanted[0], 1, wanted[2])):
        expected = f"times of {wanted[0]} Tx, 1 or {wanted[1]} Rx and {wanted[2]} frequencies"
        checks.fail("timing", expected, checks.shape_text(timing.times_s.shape))
    times_s = timing.times_s + start_s
    begin_s, end_s = float(times_s.min()), float(times_s.max())
    bodies = [body.during(begin_s, end_s) for body in moving.bodies]
    scene = moving.seen(bodies, 0.5 * (begin_s + end_s))
    resolved = merged_settings(settings, **fields).for_scene(scene).resolved()
    opened, about = open_device(device), {"start_s": start_s, "sweep_s": end_s - begin_s}
    if not any(len(body.marks_s) for body in bodies):
        still = simulate(
            scene, array, waveform, settings=resolved, device=opened, progress=progress
        )
        return replace(still, meta={**still.meta, "movement": about})
    probes = Probes.of(bodies, begin_s, end_s)
    warn_of_ambiguity(scene, array, waveform)
    # What a simulation costs apart from its Tx, in the cost of one Tx: measured with a hand.
    overhead_tx = 80.0 if resolved.estimator == "physical" else 12.0
    tolerance = 10.0 ** (tolerance_db / 20.0)
    pieces = planned(probes, array, waveform, times_s, tolerance, overhead_tx)
    between = [piece for piece in pieces if not piece.direct]
    tested_piece = between[len(between) // 2] if between else None
    total = sum(len(piece.times_s) * len(piece.tx) for piece in pieces)
    total += 0 if tested_piece is None else len(tested_piece.tx)
    done = 0
    meta: dict[str, Any] = {}

    def simulated(time_s: float, part: AntennaArray, own: SimulationSettings) -> np.ndarray:
        """Samples of some Tx at an instant, relative to the middle of what moves."""
        nonlocal done, meta
        with sampled_as(scene), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "" if meta else AMBIGUOUS, ClradarWarning)
            one = simulate(moving.seen(bodies, time_s), part, waveform, settings=own, device=opened)
        meta = meta or dict(one.meta)
        done += part.n_tx
        if progress is not None:
            progress(done, total)
        return one.data / followed(part, np.full((1, 1, 1), time_s))

    def followed(part: AntennaArray, at_s: np.ndarray) -> np.ndarray:
        """Phasors of an echo of the middle of what moves when each sample is recorded."""
        at_m = probes.at_m(at_s, MIDDLE)[..., 0, :]
        to_tx_m = np.linalg.norm(at_m - part.tx_m[:, None, None], axis=3)
        to_rx_m = np.linalg.norm(at_m - part.rx_m[None, :, None], axis=3)
        rate = -2j * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        return np.asarray(np.exp(rate * (to_tx_m + to_rx_m)))

    data = np.zeros((array.n_tx, array.n_rx, waveform.n_freq), dtype=np.complex64)
    for number, piece in enumerate(pieces):
        part, own = array.part(piece.tx, slice(None)), resolved
        if number and resolved.estimator == "stochastic":  # rays are numbered within their piece
            words = np.random.SeedSequence([resolved.seed, number]).generate_state(1, np.uint64)
            own = replace(resolved, seed=int(words[0]))
        recorded_s, doubtful_s = times_s[piece.tx], np.full((1, 1, 1), piece.doubtful_s)
        here = (piece.begin_s <= recorded_s) & (recorded_s <= piece.end_s)
        # Lagrange's polynomials grow beyond all bounds outside of their piece.
        recorded_s = np.where(here, recorded_s, piece.begin_s)
        added = np.zeros((len(piece.tx), array.n_rx, waveform.n_freq), dtype=np.complex128)
        tested = np.zeros_like(added)
        shares = zip(piece.shares(recorded_s), piece.shares(doubtful_s), strict=True)
        for time_s, (share, test) in zip(piece.times_s, shares, strict=True):
            samples = simulated(time_s, part, own)
            added += share * samples
            tested += test * samples
        data[piece.tx] = np.where(here, added * followed(part, recorded_s), data[piece.tx])
        if piece is tested_piece:
            true = simulated(piece.doubtful_s, part, own)
            error = np.linalg.norm(tested - true) / max(np.linalg.norm(true), np.finfo(float).tiny)
            about["sample_error_db"] = _decibels(float(error))
    about |= {
        "pieces": len(pieces),
        "instants": sum(len(piece.times_s) for piece in pieces),
        "phase_error_db": _decibels(max(piece.error for piece in pieces)),
    }
    settings_meta = {**meta["settings"], "seed": resolved.seed}
    return Capture(data, array, waveform, {**meta, "settings": settings_meta, "movement": about})


def _decibels(error: float) -> float:
    return 20.0 * float(np.log10(max(error, 1e-15)))

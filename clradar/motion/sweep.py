"""Simulation of one sweep over a scene that moves meanwhile."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ClradarWarning, ModelError, warn
from clradar.model import AntennaArray, Capture, Waveform, checks
from clradar.model.progress import Progress
from clradar.motion.bodies import MovingScene
from clradar.motion.instants import Group, Probes, Way, plan_groups
from clradar.motion.timing import SweepTiming
from clradar.opencl import Device, open_device
from clradar.simulation import simulate
from clradar.tracing.settings import SimulationSettings, merged_settings, takes_settings
from clradar.tracing.surface_samples import sampled_as

TOLERANCE_DB = -50.0

TORN = 3.0
"""Of `Probes.stretch`: captures of skin that was carried so far were off by -24 to -6 dB, of less
by -41 to -15 dB (docs/movement.md)."""

MOST_INSTANTS = 2048
"""Of a sweep. What needs more is most likely in another unit."""

_OVERHEAD_TX = {"physical": 80.0}
"""What a simulation costs apart from its Tx, in the cost of one Tx: measured with a hand."""


@takes_settings
def simulate_moving(
    moving: MovingScene,
    array: AntennaArray,
    waveform: Waveform,
    *,
    timing: SweepTiming | None = None,
    start_s: float = 0.0,
    tolerance_db: float = TOLERANCE_DB,
    settings: SimulationSettings | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> Capture:
    """Simulate a capture of a scene that moves while it is recorded.

    The scene is simulated at some instants of the sweep, of few Tx each or of all, and every sample
    is interpolated to its own time (E15 in ``docs/equations.md``).

    Parameters
    ----------
    moving : MovingScene
    array : AntennaArray
    waveform : Waveform
    timing : SweepTiming, optional
        When samples are recorded. Not given: `SweepTiming.in_order`, Tx by Tx.
    start_s : float, seconds
        When the sweep begins: added to the times of `timing`.
    tolerance_db : float, decibels
        Of the largest error of the interpolated phasors exp(j phase) of points on the surface;
        negative. It decides on the number of instants. Samples may be off by more, where the
        surface bends, turns away or shadows itself.
    settings, device
        As `clradar.simulate` takes them.
    progress : callable, optional
        Called with (done, total) instants times Tx.
    **fields
        Fields of `SimulationSettings`, in place of those of `settings`.

    Returns
    -------
    Capture
        Of a scene that does not move during the sweep, with the bits of ``simulate(moving.at(t),
        ...)``. ``meta["movement"]`` has the times, the instants and `phase_error_db`, the error of
        the phasors of points; what else is in `meta` is of the first instant.

    Raises
    ------
    ModelError
        As `clradar.simulate`; a timing of another radar; a movement too fast for 2048 instants.
    MeshError, DeviceError
        As `clradar.simulate`.

    Warns
    -----
    ClradarWarning
        As `clradar.simulate`, of the first instant; a hand bends so far that its skin tears.

    Examples
    --------
    A ball that comes nearer by 1 mm in the 1.9 ms of a sweep, seen by a part of the imager.

    >>> import clradar, trimesh
    >>> ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    >>> scene = clradar.Scene.from_mesh(ball.apply_translation([0, 0, 0.3]), alpha=0.5)
    >>> nearer = clradar.RigidMotion.steady(velocity_m_per_s=(0, 0, -0.5))
    >>> imager = clradar.arrays.qar50().part(slice(None, None, 24), slice(None, None, 12))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> moving = clradar.MovingScene([clradar.MovingBody(scene, nearer)])
    >>> timing = clradar.SweepTiming.in_order(4, 16, step_s=30e-6)
    >>> capture = clradar.simulate_moving(moving, imager, waveform, timing=timing)
    >>> capture.data.shape, capture.meta["movement"]["sweep_s"]
    ((4, 8, 16), 0.00189)
    """
    checks.instance("simulate_moving: moving", moving, MovingScene)
    checks.instance("simulate_moving: array", array, AntennaArray)
    checks.instance("simulate_moving: waveform", waveform, Waveform)
    start_s = checks.real("simulate_moving: start_s", start_s)
    tolerance_db = checks.real("simulate_moving: tolerance_db", tolerance_db)
    if not -100.0 <= tolerance_db < 0.0:
        checks.fail("simulate_moving: tolerance_db", "-100 to below 0", f"{tolerance_db:g}")
    if timing is None:
        timing = SweepTiming.in_order(array.n_tx, waveform.n_freq)
    checks.instance("simulate_moving: timing", timing, SweepTiming)
    timing.check(array, waveform)
    times_s = timing.times_s + start_s
    begin_s, end_s = float(times_s.min()), float(times_s.max())
    sweep = moving.during(begin_s, end_s)
    scene = sweep.scene(0.5 * (begin_s + end_s))
    resolved = merged_settings(settings, **fields).for_scene(scene).resolved()
    opened = open_device(device)
    probes = Probes.of(sweep, begin_s, end_s)
    about = {"start_s": start_s, "sweep_s": end_s - begin_s}
    if probes.way is None:
        still = simulate(
            scene, array, waveform, settings=resolved, device=opened, progress=progress
        )
        return replace(still, meta={**still.meta, "movement": about})

    if probes.stretch > TORN:
        warn(
            "simulate_moving: a hand bends so far within one sweep that its skin, carried from the "
            f"middle, tears: 1 % of its faces become {probes.stretch:.1f} times as long or longer; "
            "take a shorter sweep or a slower movement"
        )
    tolerance = 10.0 ** (tolerance_db / 20.0)
    overhead_tx = _OVERHEAD_TX.get(str(resolved.estimator), 12.0)
    marks_inside = ((probes.marks_s > begin_s) & (probes.marks_s < end_s)).any()
    best, way = np.inf, None
    groups: list[Group] = []
    for follow, cut in product((probes.way, None), (True, False) if marks_inside else (False,)):
        plan = plan_groups(
            probes, array, waveform, times_s, tolerance, overhead_tx,
            follow=follow, cut=cut, budget=best,
        )  # fmt: skip
        if plan is not None:
            (best, groups), way = plan, follow
    if not groups or sum(len(group.times_s) for group in groups) > MOST_INSTANTS:
        raise ModelError(
            f"simulate_moving: expected a movement that {MOST_INSTANTS} instants can follow, got a "
            "faster one; are the times in seconds and the shifts in metres? A table of shorter "
            "times or a larger tolerance_db makes it possible"
        )
    total = sum(len(group.times_s) * len(group.tx) for group in groups)
    done = 0
    data = np.empty((array.n_tx, array.n_rx, waveform.n_freq), dtype=np.complex64)
    meta: dict[str, Any] | None = None
    rate = -2j * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    for number, group in enumerate(groups):
        part = array.part(group.tx, slice(None))
        own = _of_group(resolved, number)
        recorded_s = times_s[group.tx]
        added = np.zeros((len(group.tx), array.n_rx, waveform.n_freq), dtype=np.complex128)
        for time_s, share in zip(group.times_s, group.shares(recorded_s), strict=True):
            with sampled_as(scene), warnings.catch_warnings():
                if meta is not None:
                    warnings.simplefilter("ignore", ClradarWarning)
                one = simulate(sweep.scene(time_s), part, waveform, settings=own, device=opened)
            if meta is None:
                meta = dict(one.meta)
            samples = one.data.astype(np.complex128)
            if way is not None:
                samples /= np.exp(rate * _followed_m(way, part, np.full((1, 1, 1), time_s)))
            added += share * samples
            done += len(group.tx)
            if progress is not None:
                progress(done, total)
        if way is not None:
            added *= np.exp(rate * _followed_m(way, part, recorded_s))
        data[group.tx] = added
    assert meta is not None
    about |= {
        "groups": len(groups),
        "instants": sum(len(group.times_s) for group in groups),
        "phase_error_db": 20.0 * float(np.log10(max(max(group.error for group in groups), 1e-15))),
    }
    settings_meta = {**meta["settings"], "seed": resolved.seed}
    return Capture(data, array, waveform, {**meta, "settings": settings_meta, "movement": about})


def _of_group(settings: SimulationSettings, number: int) -> SimulationSettings:
    """The settings of a group: rays of chance are numbered within it, so each has its own seed."""
    if number == 0 or settings.estimator != "stochastic":
        return settings
    words = np.random.SeedSequence([settings.seed, number]).generate_state(1, np.uint64)
    return replace(settings, seed=int(words[0]))


def _followed_m(way: Way, array: AntennaArray, times_s: np.ndarray) -> np.ndarray:
    """Two-way lengths of a point on its way when each sample is recorded.

    Shape (n_tx, n_rx, n_freq or 1); `times_s` (n_tx or 1, n_rx or 1, n_freq or 1).
    """
    at_m = way.at_m(times_s)
    to_tx_m = np.linalg.norm(at_m - array.tx_m[:, None, None], axis=3)
    to_rx_m = np.linalg.norm(at_m - array.rx_m[None, :, None], axis=3)
    return np.asarray(to_tx_m + to_rx_m)

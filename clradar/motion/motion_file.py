"""Motion files: how bodies and hands move, and when the imager records; docs/movement.md."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import MeasurementError, ModelError
from clradar.files.failures import fail, read_bytes, reading, shown
from clradar.files.limits import MAX_TIMES_BYTES
from clradar.model import AntennaArray, Scene, Waveform, checks
from clradar.motion.bodies import MovingBody, MovingScene
from clradar.motion.hands import MovingHand
from clradar.motion.rigid import RigidMotion
from clradar.motion.timing import STEP_S, SweepTiming
from clradar.opencl import Device

_EXPECTED = "a motion (a TOML file, see docs/movement.md)"


@dataclass(frozen=True, slots=True)
class Motion:
    """What a motion file says.

    Motions by the name of a mesh file ("": of all others), arguments of `MovingHand`, order and
    step of `SweepTiming.in_order` or times (n_tx or n_tx * n_rx, n_freq) of a table, seconds, the
    time from one cluster to the next (None: when it has ended), and all files that were read.
    """

    bodies: Mapping[str, RigidMotion]
    hands: tuple[Mapping[str, Any], ...]
    order: str
    step_s: float
    table_s: np.ndarray | None
    cluster_s: float | None
    files: tuple[Path, ...]

    def timing(self, array: AntennaArray, waveform: Waveform) -> SweepTiming:
        """Return when the samples of a sweep of this radar are recorded."""
        n_tx, n_freq = array.n_tx, waveform.n_freq
        if self.table_s is None:
            return SweepTiming.in_order(n_tx, n_freq, step_s=self.step_s, order=self.order)
        rows, columns = self.table_s.shape
        if rows not in (n_tx, n_tx * array.n_rx) or columns != n_freq:
            expected = f"{n_tx} rows, one per Tx (or {n_tx * array.n_rx}, Tx by Tx, one per Rx)"
            checks.fail(
                f"{self.files[0]}: sweep.table_us",
                f"{expected} of {n_freq} times, one per frequency",
                f"{rows} rows of {columns}",
            )
        return SweepTiming(self.table_s.reshape(n_tx, rows // n_tx, n_freq))

    def timings(self, clusters: Sequence[AntennaArray], waveform: Waveform) -> list[SweepTiming]:
        """Return when samples are recorded by clusters that take turns, or by the only array."""
        own = [self.timing(array, waveform) for array in clusters]
        turn_s = self.cluster_s
        if turn_s is None:
            last_s = self.step_s if self.table_s is None else 0.0
            turn_s = own[0].end_s - own[0].begin_s + last_s
        return [SweepTiming(timing.times_s + i * turn_s) for i, timing in enumerate(own)]

    def scene(
        self,
        bodies: Mapping[str, Scene],
        *,
        finish: Callable[[Scene], Scene] | None = None,
        alpha: float = 0.5,
        device: Device | str | None = None,
    ) -> MovingScene:
        """Return the moving scene of meshes by their names, and of the hands of the file."""
        for name in self.bodies:
            if name and name not in bodies:
                named = ", ".join(map(repr, bodies)) or "none"
                checks.fail(
                    f"{self.files[0]}: body.mesh", f"one of the meshes: {named}", repr(name)
                )
        moving: list[Any] = [
            MovingBody(scene, self.bodies.get(name, self.bodies.get("")))
            for name, scene in bodies.items()
        ]
        moving += [MovingHand(**hand, alpha=alpha, device=device) for hand in self.hands]
        if not moving:
            checks.fail(f"{self.files[0]}", "a mesh, or [[hand]] in the file", "neither")
        return MovingScene(moving, finish)


def read_motion(path: str | os.PathLike[str]) -> Motion:
    """Return what a motion file says; docs/movement.md has the format.

    Examples
    --------
    >>> from pathlib import Path
    >>> import clradar
    >>> text = '''
    ... [[body]]
    ... velocity_mm_per_s = [0, 0, 500]
    ... '''
    >>> _ = Path("away.toml").write_text(text)
    >>> clradar.read_motion("away.toml").bodies[""].at(0.1)[:3, 3].tolist()
    [0.0, 0.0, 0.05]
    """
    from clradar.files.records import read_record
    from clradar.motion.motion_record import MotionFile

    path = Path(path)
    found = read_record(path, MotionFile, _EXPECTED)
    files, hands = [path], []
    for i, hand in enumerate(found.hand):
        try:
            hands.append(hand.arguments(path.parent, files))
        except ModelError as error:
            raise MeasurementError(f"{shown(path)}: hand[{i}]: {error}") from error
    sweep, table_s, cluster_s = found.sweep, None, None
    if sweep.table_us is not None:
        files.append(path.parent / sweep.table_us)
        table_s = _times_s(files[-1])
    if sweep.cluster_us is not None:
        cluster_s = sweep.cluster_us * 1e-6
    step_s = sweep.step_us * 1e-6 if "step_us" in sweep.model_fields_set else STEP_S
    bodies = {body.mesh: body._motion for body in found.body}
    return Motion(bodies, tuple(hands), sweep.order, step_s, table_s, cluster_s, tuple(files))


def _times_s(path: Path) -> np.ndarray:
    """Times of a table in microseconds, in seconds, shape (rows, columns)."""
    expected = "a table of times in microseconds, numbers between commas"
    content = read_bytes(path, expected, MAX_TIMES_BYTES)
    with reading(path, expected):
        lines = content.decode("utf-8-sig").splitlines()
        rows = [[float(text) for text in line.split(",")] for line in lines if line.strip()]
    if not rows or len({len(row) for row in rows}) > 1:
        fail(path, "rows of numbers, all as long as each other", "rows of different lengths")
    times_us = np.array(rows)
    if not np.isfinite(times_us).all() or np.abs(times_us).max() > 1e12:
        fail(path, "finite times in microseconds", "others")
    return times_us / 1e6

"""Motion files: how bodies and hands move, and when the imager records; docs/movement.md."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.errors import ModelError
from clradar.files.failures import fail, read_bytes, reading
from clradar.files.limits import MAX_TIMES_BYTES
from clradar.files.table import StrictTable
from clradar.files.toml_file import read_toml
from clradar.hand.mesh import DEFAULT_CENTER_M, DEFAULT_EDGE_LENGTH_M
from clradar.hand.shape import AVERAGE, HandShape
from clradar.model import AntennaArray, Scene, Waveform, checks
from clradar.motion.bodies import MovingBody, MovingScene
from clradar.motion.hands import MovingHand
from clradar.motion.rigid import BEYOND, PROFILES, RigidMotion
from clradar.motion.timing import ORDERS, STEP_S, SweepTiming
from clradar.opencl import Device

if TYPE_CHECKING:
    from clradar.rigs import Rig

_EXPECTED = "a motion (a TOML file, see docs/movement.md)"
MAX_PLACES = 10_000


@dataclass(frozen=True, slots=True)
class Motion:
    """What a motion file says.

    Attributes
    ----------
    bodies : mapping of str to RigidMotion
        By the name of a mesh file; "" stands for all that have none of their own.
    hands : tuple of mapping
        Arguments of `MovingHand`.
    order, step_s : str, float
        As `SweepTiming.in_order` takes them.
    table_s : ndarray, shape (n_tx, n_freq) or (n_tx * n_rx, n_freq), seconds, or None
        Times of a table, instead.
    cluster_s : float or None, seconds
        From the sweep of one cluster to that of the next; None: when it has ended.
    files : tuple of Path
        All files that were read.
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
        """Return the moving scene of meshes by their names, and of the hands of the file.

        Raises
        ------
        ModelError
            The file names a mesh that is not there, or there is nothing at all.
        """
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

    Raises
    ------
    MeasurementError
        The file, a pose or a table of times is missing or damaged, a key is unknown, or a value
        invalid. The message names the file, the key, what was expected and found.
    RigError
        A rig is missing or damaged.

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
    path = Path(path)
    table = StrictTable(str(path), "", read_toml(path, _EXPECTED))
    files = [path]
    bodies: dict[str, RigidMotion] = {}
    for own in table.tables("body"):
        name = own.text("mesh", "the name of a mesh file") or ""
        if name in bodies:
            own.fail("mesh", "one [[body]] of each mesh, one without", f"two of '{name}'")
        motion = _rigid(own, needed=True)
        assert motion is not None
        bodies[name] = motion
        own.done()
    hands = tuple(_hand(own, path, files) for own in table.tables("hand"))
    sweep = table.table("sweep")
    order = sweep.one_of("order", "tx", ORDERS)
    step_us = sweep.number("step_us")
    named = sweep.text("table_us", "the name of a table of times, .csv")
    if step_us is not None and not 0 <= step_us < 1e9:
        sweep.fail("step_us", "a time of at least 0 microseconds", step_us)
    if named is not None and (sweep.has("order") or step_us is not None):
        sweep.fail("table_us", "neither order nor step_us beside it", "both")
    cluster_us = sweep.number("cluster_us")
    if cluster_us is not None and not 0 <= cluster_us < 1e12:
        sweep.fail("cluster_us", "a time of at least 0 microseconds", cluster_us)
    sweep.done()
    table.done()
    table_s = None
    if named is not None:
        files.append(path.parent / named)
        table_s = _times_s(files[-1])
    if not bodies and not hands:
        table.fail("body", "[[body]] or [[hand]], at least one", "none")
    step_s = STEP_S if step_us is None else step_us * 1e-6
    cluster_s = None if cluster_us is None else cluster_us * 1e-6
    return Motion(bodies, hands, str(order), step_s, table_s, cluster_s, tuple(files))


def _rigid(table: StrictTable, *, needed: bool) -> RigidMotion | None:
    """The rigid motion of a body or a hand; None if it has none and needs none."""
    velocity_mm = table.numbers("velocity_mm_per_s", 3)
    turn_deg = table.numbers("turn_deg_per_s", 3)
    about_m = [v / 1e3 for v in table.numbers("about_mm", 3) or (0.0, 0.0, 0.0)]
    places = table.tables("place")
    steady = velocity_mm is not None or turn_deg is not None
    if steady == bool(places):
        if not needed and not steady:
            if table.has("about_mm"):
                table.fail("about_mm", "a motion beside it", "none")
            return None
        expected = "either velocity_mm_per_s or turn_deg_per_s, or [[place]] with times"
        table.fail("place", expected, "both" if steady else "none")
    still = (0.0, 0.0, 0.0)
    if steady:
        velocity_m = np.asarray(velocity_mm or still) / 1e3
        return RigidMotion.steady(velocity_m, np.radians(turn_deg or still), about_m)
    times_s, shifts_mm, turns_deg = [], [], []
    for own in _bounded(table, "place", places):
        times_s.append(_time_s(own))
        shifts_mm.append(own.numbers("shift_mm", 3) or still)
        turns_deg.append(own.numbers("turn_deg", 3) or still)
        own.done()
    profile = table.one_of("profile", "linear", PROFILES) if needed else "linear"
    beyond = table.one_of("beyond", "hold", BEYOND)
    with _at(table):
        return RigidMotion(
            np.array(times_s), np.array(shifts_mm) / 1e3, np.radians(turns_deg), about_m,
            str(profile), str(beyond),
        )  # fmt: skip


def _hand(table: StrictTable, path: Path, files: list[Path]) -> dict[str, Any]:
    """The arguments of `MovingHand`."""
    times_s, poses = [], []
    for own in _bounded(table, "pose", table.tables("pose")):
        times_s.append(_time_s(own))
        pose = own.text("pose", "the name of a pose, or of a pose file")
        if pose is None:
            own.fail("pose", "the name of a pose, or of a pose file", "none")
        own.done()
        if Path(pose).suffix:
            files.append(path.parent / pose)
            poses.append(str(files[-1]))
        else:
            poses.append(pose)
    if not poses:
        table.fail("pose", "[[hand.pose]] with time_s and pose, at least one", "none")
    made: dict[str, Any] = {"times_s": times_s, "poses": poses}
    made["profile"] = table.one_of("profile", "smooth", PROFILES)
    made["motion"] = _rigid(table, needed=False)
    center_mm = table.numbers("center_mm", 3)
    if table.has("rig"):
        for key in _OF_EMBEDDED:
            if table.has(key):
                table.fail(key, "none beside rig, which keeps mesh, size and side as it is", "both")
        made["rig"] = _rig(table, path, files)
    made["center_m"] = DEFAULT_CENTER_M if center_mm is None else [v / 1e3 for v in center_mm]
    made["handedness"] = table.one_of("handedness", "right", ("right", "left"))
    edge_mm = table.number("edge_mm")
    made["edge_length_m"] = DEFAULT_EDGE_LENGTH_M if edge_mm is None else edge_mm / 1e3
    lengths_mm = table.number("length_mm"), table.number("breadth_mm")
    girth = table.number("girth")
    fingers: Any = table.numbers("finger_lengths", 5)
    table.done()
    with _at(table):
        made["shape"] = HandShape(
            AVERAGE.length_m if lengths_mm[0] is None else lengths_mm[0] / 1e3,
            AVERAGE.breadth_m if lengths_mm[1] is None else lengths_mm[1] / 1e3,
            AVERAGE.finger_lengths if fingers is None else fingers,
            AVERAGE.girth if girth is None else girth,
        )
        hand = MovingHand(**made)  # reads its poses
    return {**made, "poses": hand.poses}


_OF_EMBEDDED = ("handedness", "edge_mm", "length_mm", "breadth_mm", "girth", "finger_lengths")


def _rig(table: StrictTable, path: Path, files: list[Path]) -> Rig:
    """The rigged hand of a file, with the keys of the command line's options."""
    from clradar.rigs import read_rig

    names = [table.text(key, "the name of a file") for key in ("rig", "mapping")]
    rig, mapping = (None if name is None else path.parent / name for name in names)
    unit = table.number_or_text("rig_unit")
    hand = table.one_of("rig_hand", None, ("right", "left"))
    betas = table.numbers("betas")
    assert rig is not None
    files += [rig] if mapping is None else [rig, mapping]
    with _at(table):
        return read_rig(
            rig,
            mapping=mapping,
            unit=unit if unit is None or isinstance(unit, str) else unit / 1e3,
            handedness=hand,
            betas=betas,
        )


def _bounded(table: StrictTable, key: str, tables: list[StrictTable]) -> list[StrictTable]:
    if len(tables) > MAX_PLACES:
        table.fail(key, f"at most {MAX_PLACES} tables", f"{len(tables)}")
    return tables


def _time_s(table: StrictTable) -> float:
    time_s = table.number("time_s")
    if time_s is None:
        table.fail("time_s", "a time in seconds", "none")
    return time_s


@contextmanager
def _at(table: StrictTable) -> Iterator[None]:
    """Name the file and the table in errors about values."""
    try:
        yield
    except ModelError as error:
        table.fail_with(f": {error}")


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

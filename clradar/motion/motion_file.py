"""Motion files: how bodies and hands move, and when the imager records; docs/movement.md."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from clradar.files.failures import reading
from clradar.files.records import (
    FileRecord,
    Number,
    NumberOrText,
    Numbers,
    Vector,
    made,
    mistake,
    one_of,
    read_record,
    text,
)
from clradar.hand.mesh import DEFAULT_CENTER_M, DEFAULT_EDGE_LENGTH_M
from clradar.hand.shape import AVERAGE, HandShape
from clradar.model import AntennaArray, Scene, Waveform, checks
from clradar.motion.hands import MovingHand
from clradar.motion.instants import ORDERS, STEP_S, SweepTiming
from clradar.motion.rigid import BEYOND, PROFILES, STILL, MovingBody, RigidMotion
from clradar.motion.sweep import MovingScene
from clradar.opencl import Device

MAX_PLACES = 10_000
ZERO = (0.0, 0.0, 0.0)
TIME_US = "a time of at least 0 microseconds"
Time = Annotated[Number, Field(description="a time in seconds")]
FileName = Annotated[str, text("the name of a file")]


class PlaceTable(FileRecord):
    """Where a body is at a time."""

    time_s: Time
    shift_mm: Vector = ZERO
    turn_deg: Vector = ZERO


class Moving(FileRecord):
    """The rigid motion of a body or a hand."""

    velocity_mm_per_s: Vector = ZERO
    turn_deg_per_s: Vector = ZERO
    about_mm: Vector = ZERO
    place: tuple[PlaceTable, ...] = Field((), max_length=MAX_PLACES)
    beyond: Annotated[str, one_of(*BEYOND)] = "hold"

    _motion: RigidMotion = PrivateAttr(STILL)

    @model_validator(mode="after")
    def _is_one_motion(self) -> Moving:
        given, of_body = self.model_fields_set, isinstance(self, BodyTable)
        steady = not given.isdisjoint({"velocity_mm_per_s", "turn_deg_per_s"})
        if steady == bool(self.place) and (of_body or steady):
            expected = "either velocity_mm_per_s or turn_deg_per_s, or [[place]] with times"
            raise mistake(expected, "both" if steady else "none", key="place")
        for key, alone in (("beyond", True), ("profile", of_body), ("about_mm", not steady)):
            if alone and key in given and not self.place:
                expected = "a motion" if key == "about_mm" else "[[place]]"
                raise mistake(f"{expected} beside it", "none", key=key)
        about_m = np.array(self.about_mm) / 1e3
        if steady:
            velocity_m = np.array(self.velocity_mm_per_s) / 1e3
            turn_rad = np.radians(self.turn_deg_per_s)
            self._motion = RigidMotion.steady(velocity_m, turn_rad, about_m)
        elif self.place:
            self._motion = made(
                RigidMotion, [own.time_s for own in self.place],
                np.array([own.shift_mm for own in self.place]) / 1e3,
                np.radians([own.turn_deg for own in self.place]), about_m,
                self.profile if isinstance(self, BodyTable) else "linear", self.beyond,
            )  # fmt: skip
        return self


class BodyTable(Moving):
    """The motion of a mesh, or of all that have none of their own."""

    mesh: Annotated[str, text("the name of a mesh file")] = ""
    profile: Annotated[str, one_of(*PROFILES)] = "linear"


class PoseTable(FileRecord):
    """The pose of a hand at a time."""

    time_s: Time
    pose: Annotated[str, text("the name of a pose, or of a pose file")]


_OF_RIGS = ("mapping", "rig_unit", "rig_hand", "betas")
_OF_EMBEDDED = ("handedness", "edge_mm", "length_mm", "breadth_mm", "girth", "finger_lengths")


class HandTable(Moving):
    """A hand of this package, or a rigged one, and its poses."""

    pose: tuple[PoseTable, ...] = Field(
        min_length=1, max_length=MAX_PLACES,
        description=f"[[hand.pose]] with time_s and pose, from one to {MAX_PLACES}",
    )  # fmt: skip
    profile: Annotated[str, one_of(*PROFILES)] = "smooth"
    center_mm: Vector = (0.0, 0.0, 1e3 * DEFAULT_CENTER_M[2])
    rig: FileName | None = None
    mapping: FileName | None = None
    rig_unit: NumberOrText | None = None
    rig_hand: Annotated[str | None, one_of("right", "left")] = None
    betas: Numbers | None = None
    handedness: Annotated[str, one_of("right", "left")] = "right"
    edge_mm: Number = 1e3 * DEFAULT_EDGE_LENGTH_M
    length_mm: Number = 1e3 * AVERAGE.length_m
    breadth_mm: Number = 1e3 * AVERAGE.breadth_m
    girth: Number = AVERAGE.girth
    finger_lengths: tuple[Number, Number, Number, Number, Number] = AVERAGE.finger_lengths

    @model_validator(mode="after")
    def _fits_together(self) -> HandTable:
        for key in _OF_EMBEDDED if self.rig else _OF_RIGS:
            if key in self.model_fields_set:
                expected = "none beside rig, which keeps mesh, size and side as it is"
                raise mistake(*((expected, "both") if self.rig else ("a rig", "none")), key=key)
        return self

    def moving(self, folder: Path, files: list[Path]) -> MovingHand:
        """Return the hand, whose files are in a folder and are added to a list."""
        poses = [folder / p.pose if Path(p.pose).suffix else p.pose for p in self.pose]
        files += [pose for pose in poses if isinstance(pose, Path)]
        rig = None
        if self.rig is not None:
            from clradar.rigs import read_rig

            unit = self.rig_unit / 1e3 if isinstance(self.rig_unit, int | float) else self.rig_unit
            used = [folder / name for name in (self.rig, self.mapping) if name]
            files += used
            rig = read_rig(
                used[0], mapping=used[1] if self.mapping else None, unit=unit,
                handedness=self.rig_hand, betas=self.betas,
            )  # fmt: skip
        size_m = self.length_mm / 1e3, self.breadth_mm / 1e3
        return MovingHand(
            [own.time_s for own in self.pose], poses, self.profile, self._motion,
            [v / 1e3 for v in self.center_mm], HandShape(*size_m, self.finger_lengths, self.girth),
            self.edge_mm / 1e3, self.handedness, rig,
        )  # fmt: skip


class SweepTable(FileRecord):
    """When the samples of a sweep are recorded."""

    order: Annotated[str, one_of(*ORDERS)] = "tx"
    step_us: Annotated[Number, Field(ge=0, lt=1e9, description=TIME_US)] = 1e6 * STEP_S


class MotionFile(FileRecord):
    """The tables of a motion file."""

    body: tuple[BodyTable, ...] = Field((), description="tables [[body]]")
    hand: tuple[HandTable, ...] = Field((), description="tables [[hand]]")
    sweep: SweepTable = SweepTable()

    @model_validator(mode="after")
    def _moves_something(self) -> MotionFile:
        names = [own.mesh for own in self.body]
        for i, name in enumerate(names):
            if name in names[:i]:
                expected = "one [[body]] of each mesh, one without"
                raise mistake(expected, f"two of '{name}'", key=("body", i, "mesh"))
        if not names and not self.hand:
            raise mistake("[[body]] or [[hand]], at least one", "none", key="body")
        return self


@dataclass(frozen=True, slots=True)
class Motion:
    """What a motion file says, and the files that were read.

    Motions of bodies are by the name of a mesh file, "" of all others.
    """

    bodies: dict[str, RigidMotion]
    hands: list[MovingHand]
    sweep: SweepTable
    files: list[Path]

    def timings(self, clusters: Sequence[AntennaArray], waveform: Waveform) -> list[SweepTiming]:
        """Return when samples are recorded by clusters that take turns, or by the only array."""
        step_s, order = self.sweep.step_us / 1e6, self.sweep.order
        own = [
            SweepTiming.in_order(array.n_tx, waveform.n_freq, step_s=step_s, order=order)
            for array in clusters
        ]
        turn_s = own[0].end_s - own[0].begin_s + step_s
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
        motions = {"": STILL, **self.bodies}
        moving: list[Any] = [
            MovingBody(scene, motions.get(name, motions[""])) for name, scene in bodies.items()
        ]
        moving += [replace(hand, alpha=alpha, device=device) for hand in self.hands]
        if not moving:
            checks.fail(f"{self.files[0]}", "a mesh, or [[hand]] in the file", "neither")
        return MovingScene(moving, finish)


def read_motion(path: str | os.PathLike[str]) -> Motion:
    """Return what a motion file says; docs/movement.md has the format.

    Examples
    --------
    >>> clradar.read_motion("motion.toml").bodies[""].at(0.1)[:3, 3].tolist()
    [0.0, 0.0, 0.05]
    """
    path, expected = Path(path), "a motion (a TOML file, see docs/movement.md)"
    found, hands, files = read_record(path, MotionFile, expected), list[MovingHand](), [path]
    for i, hand in enumerate(found.hand):
        with reading(f"{path}: hand[{i}]", expected):
            hands.append(hand.moving(path.parent, files))
    return Motion({own.mesh: own._motion for own in found.body}, hands, found.sweep, files)

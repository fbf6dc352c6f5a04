"""A synthetic recorder: recordings of point targets with the errors of a real instrument.

    made = Recorder(points_m=[[0.02, 0.01, 0.3]]).write(tmp_path, n_frames=4)

Signals come from `clradar.impair`, which has tests of its own against closed forms. `frame(i)`,
`empty(i)` and `ideal(i)` give the captures without any file.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import clradar
from clradar import AntennaArray, Capture, ChannelResponse, Wall, Waveform, reference
from measurement_io import save_recording

FIRST_US = 1_700_000_000_000_000
INTERVAL_US = 100_000
WALLS = (Wall([0, 0, 1.1], [0, 0, -1], 4.0), Wall([0.7, 0, 0], [-1, 0, 0.2], 2.0))


@dataclass(frozen=True)
class Recorder:
    """A scene in a room, and the instrument that records it with faults of `clradar.impair`.

    Every fault can be turned off: `walls=()`, `channels=None`, and None or 0 for the others. Drift
    is by frame; the empty room was recorded `drift_frames` frames before frame 0.
    """

    points_m: Any = ((0.0, 0.0, 0.3),)
    array: AntennaArray = field(default_factory=clradar.arrays.qar50)
    waveform: Waveform = field(default_factory=lambda: Waveform.sfcw(72e9, 82e9, 128))
    walls: tuple[Wall, ...] = WALLS
    coupling_db: float | None = 20.0
    channels: ChannelResponse | str | None = "drawn"
    snr_db: float | None = 20.0
    iq_gain_db: float = 0.2
    iq_phase_rad: float = 0.02
    adc_bits: int | None = 14
    drift_phase_rad: float = 0.0
    drift_gain_db: float = 0.0
    drift_common_phase_rad: float = 0.0
    drift_frames: int = 0
    seed: int = 0

    def response(self) -> ChannelResponse | None:
        """The channels' errors."""
        if isinstance(self.channels, str):
            return clradar.draw_channels(self.array, self.waveform, seed=self.seed)
        return self.channels

    @cached_property
    def scene(self) -> Capture:
        """What an instrument without faults records of the points alone."""
        ones = np.ones(len(self.points_m))
        return reference.point_targets(self.array, self.waveform, self.points_m, ones)

    @cached_property
    def room(self) -> Capture | None:
        """What it records of the walls alone."""
        if not self.walls:
            return None
        return clradar.room_capture(self.array, self.waveform, self.walls)

    def frame(self, number: int = 0) -> Capture:
        """Frame `number`, 0 being the first with the object."""
        return self._recorded(self.scene, number + self.drift_frames, self.seed)

    def empty(self, number: int = 0) -> Capture:
        """Frame `number` of the empty room."""
        nothing = Capture(np.zeros_like(self.scene.data), self.array, self.waveform)
        return self._recorded(nothing, number, self.seed + 1)

    def ideal(self, number: int = 0) -> Capture:
        """Frame `number` without room, coupling, noise and converters: what cleaning aims at."""
        settings = {"channels": self.response(), **self._drift()}
        frame = number + self.drift_frames
        return clradar.impair(self.scene, seed=self.seed, frame=frame, **settings)

    def _drift(self) -> dict[str, float]:
        names = ("drift_phase_rad", "drift_gain_db", "drift_common_phase_rad")
        return {name: getattr(self, name) for name in names}

    def _recorded(self, scene: Capture, frame: int, noise_seed: int) -> Capture:
        power = float((np.abs(self.scene.data.astype(complex)) ** 2).mean())
        instrument = {"iq_gain_db": self.iq_gain_db, "iq_phase_rad": self.iq_phase_rad}
        instrument |= {"channels": self.response(), **self._drift()}
        same = {"frame": frame, "reference_power": power}
        around = {"room": self.room, "coupling_db": self.coupling_db}
        arriving = clradar.impair(scene, seed=self.seed, **same, **around, **instrument)
        # Channels and drift belong to the instrument, but the empty room has noise of its own.
        converted = {"snr_db": self.snr_db, "adc_bits": self.adc_bits}
        return clradar.impair(arriving, seed=noise_seed, **same, **converted)

    def write(self, parent: Path, n_frames: int = 3, *, emptyfiltered: bool = True) -> Recording:
        """Write frames, and two of the empty room, as recordings.

        With `emptyfiltered` also every frame minus the empty room's frame 0.
        """
        folder, empty = parent / "object" / "30", parent / "empty" / "30"
        stamps_us = [FIRST_US + i * INTERVAL_US for i in range(n_frames)]
        frames = [self.frame(i) for i in range(n_frames)]
        empties = [self.empty(i) for i in range(2)]
        radar = save_recording(folder, frames, timestamps_us=stamps_us)
        if emptyfiltered:
            cleaned = [replace(f, data=f.data - empties[0].data) for f in frames]
            for frame in save_recording(parent / "cleaned", cleaned).rglob("*.npy"):
                frame.rename(radar / "calibrated_data" / f"{frame.stem}_emptyfiltered.npy")
            shutil.rmtree(parent / "cleaned")
        save_recording(empty, empties, timestamps_us=stamps_us[:2])
        return Recording(folder, empty, self, frames)


@dataclass(frozen=True)
class Recording:
    """What was written: `<object>/<distance>`, `<empty>/<distance>`, the truth, and the frames."""

    folder: Path
    empty: Path
    recorder: Recorder
    frames: list[Capture]

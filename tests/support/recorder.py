"""A synthetic recorder: recordings of point targets with the errors of a real instrument.

    made = Recorder(points_m=[[0.02, 0.01, 0.3]]).write(tmp_path, n_frames=4)
    made.folder      tmp_path/object/30, in the MAROON form (shared with nobody: tests/maroon_files)
    made.empty       tmp_path/empty/30, the same room without the object
    made.recorder    the truth: points, channels, walls, every single frame as it should be read

It shares no code with `measurement_io`, so that readers of its files are compared with something
else. Signals come from `clradar.impair`, which has tests of its own against closed forms.
`frame(i)`, `empty(i)` and `ideal(i)` give the captures without any file.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import maroon_files
import numpy as np

import clradar
from clradar import AntennaArray, Capture, ChannelResponse, Wall, Waveform

C = 299_792_458.0
FIRST_US = 1_700_000_000_000_000
INTERVAL_US = 100_000
NO_ANTENNA = 1e4 + 1e4j
"""What channels 0 and 95 hold: so strong that an image shows it if they are taken for antennas."""
WALLS = (Wall([0, 0, 1.1], [0, 0, -1], 4.0), Wall([0.7, 0, 0], [-1, 0, 0.2], 2.0))


@dataclass(frozen=True)
class Recorder:
    """A scene in a room, and the instrument that records it.

    Every fault can be turned off: `walls=()`, `channels=None`, and None or 0 for the others.

    Attributes
    ----------
    points_m : (n, 3), antenna frame; amplitudes : (n,) complex
        Isotropic point targets: s = a exp(-j 2 pi f (|p - tx| + |p - rx|) / c).
    array, waveform
        Files hold arrays of 94 x 94 only.
    walls, coupling_db, channels, snr_db, iq_gain_db, iq_phase_rad, adc_bits
        As `clradar.impair` has them; decibels are relative to the mean power of the points.
        `channels="drawn"`: +-3 dB, any phase, +-20 ps, from `seed`.
    drift_phase_rad, drift_gain_db, drift_common_phase_rad
        Steps per frame. The empty room was recorded `drift_frames` frames before frame 0.
    """

    points_m: Any = ((0.0, 0.0, 0.3),)
    amplitudes: Any = None
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

    @property
    def points_radar_m(self) -> np.ndarray:
        """The points in the radar space of such recordings, whose x is mirrored."""
        return np.asarray(self.points_m, float) * [-1, 1, 1]

    def response(self) -> ChannelResponse | None:
        """The channels' errors."""
        if isinstance(self.channels, str):
            return clradar.draw_channels(self.array, self.waveform, seed=self.seed)
        return self.channels

    @cached_property
    def scene(self) -> Capture:
        """What an instrument without faults records of the points alone."""
        k = 2 * np.pi * self.waveform.frequencies_hz / C
        points = np.asarray(self.points_m, float)
        amplitudes = np.ones(len(points)) if self.amplitudes is None else self.amplitudes
        data = np.zeros((self.array.n_tx, self.array.n_rx, len(k)), complex)
        for point, amplitude in zip(points, amplitudes, strict=True):
            to_tx, to_rx = (
                np.exp(-1j * np.outer(np.linalg.norm(side - point, axis=1), k))
                for side in (self.array.tx_m, self.array.rx_m)
            )
            data += amplitude * to_tx[:, None] * to_rx
        return Capture(data, self.array, self.waveform)

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
        arriving = clradar.impair(
            scene,
            seed=self.seed,
            frame=frame,
            reference_power=power,
            room=self.room,
            coupling_db=self.coupling_db,
            channels=self.response(),
            **self._drift(),
            iq_gain_db=self.iq_gain_db,
            iq_phase_rad=self.iq_phase_rad,
        )
        # Channels and drift belong to the instrument, but the empty room has noise of its own.
        return clradar.impair(
            arriving,
            seed=noise_seed,
            frame=frame,
            reference_power=power,
            snr_db=self.snr_db,
            adc_bits=self.adc_bits,
        )

    def write(
        self,
        parent: Path,
        n_frames: int = 3,
        n_empty: int = 2,
        *,
        name: str = "object",
        distance_cm: int = 30,
        emptyfiltered: bool = True,
        cut_short: int | None = None,
        missing: int | None = None,
        wrong_count: int | None = None,
    ) -> Recording:
        """Write frames and the empty room as folders in the MAROON form.

        Parameters
        ----------
        n_empty
            Frames of the empty room, one folder for all objects of `parent`; 0 for none.
        emptyfiltered
            Also write every frame minus the empty room's frame 0.
        cut_short, missing
            Frame whose file ends in the middle, frame whose file is not there.
        wrong_count
            `number_of_measurements` of every frame instead of `n_frames`.
        """
        truth = {}
        folder = parent / name / str(distance_cm)
        empty = parent / "empty" / str(distance_cm)
        count = n_frames if wrong_count is None else wrong_count
        without = self.empty(0)
        radar = self._radar_folder(folder)
        for i in range(n_frames):
            truth[i] = self.frame(i)
            path = self._write_frame(radar, truth[i].data, i, "", count)
            if emptyfiltered:
                filtered = truth[i].data - without.data
                self._write_frame(radar, filtered, i, "_emptyfiltered", count)
            if i == cut_short:
                content = path.read_bytes()
                path.write_bytes(content[: len(content) // 2])
            if i == missing:
                path.unlink()
        if n_empty:
            empty_radar = self._radar_folder(empty)
        for i in range(n_empty):
            self._write_frame(empty_radar, self.empty(i).data, i, "", n_empty)
        metadata = {"distance_meters": distance_cm / 100, "empty_measurement": "empty"}
        (folder / "metadata.json").write_text(json.dumps(metadata))
        alignment = {"photogrammetry2radar": np.diag([-1.0, 1.0, 1.0, 1.0]).tolist()}
        (folder / "alignment.json").write_text(json.dumps(alignment))
        return Recording(folder, radar, empty, self, truth)

    def _radar_folder(self, distance: Path) -> Path:
        low, high = (float(f) / 1e9 for f in self.waveform.frequencies_hz[[0, -1]])
        radar = distance / f"radar_{low}_{high}_{self.waveform.n_freq}"
        (radar / "calibrated_data").mkdir(parents=True)
        sweep = {
            "frequency_low_ghz": low,
            "frequency_high_ghz": high,
            "frequency_points": self.waveform.n_freq,
        }
        (radar / "calibration.json").write_text(json.dumps(sweep))
        return radar

    def _write_frame(self, radar: Path, data: np.ndarray, i: int, suffix: str, count: int) -> Path:
        xr = np.full((96, 96, data.shape[2]), NO_ANTENNA, np.complex64)
        for tx in range(94):
            xr[1:95, 1 + tx, :] = data[tx]
        frame = {
            "xr": xr,
            "fvec": np.array(self.waveform.frequencies_hz),
            "number_of_measurements": count,
            "timestamp_us": np.array([FIRST_US + i * INTERVAL_US]),
        }
        return maroon_files.write_frame(radar / "calibrated_data" / f"{i:06d}{suffix}.npy", frame)


@dataclass(frozen=True)
class Recording:
    """What was written.

    Attributes
    ----------
    folder, radar : Path
        `<object>/<distance>`, and the radar folder in it.
    empty : Path
        `<empty>/<distance>`.
    recorder : Recorder
        The truth.
    frames : dict of int to Capture
        What every frame holds, also of those that were damaged or left out afterwards.
    """

    folder: Path
    radar: Path
    empty: Path
    recorder: Recorder
    frames: dict[int, Capture]

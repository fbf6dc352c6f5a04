"""The recording of a scene that moves, frame by frame, with its truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.options.motion import TRUTH, replaced_in
from clradar.cli.outputs import save, whole_folder
from clradar.cli.recording_conversion import described
from clradar.errors import warn
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from clradar import (
        AntennaArray,
        Capture,
        Device,
        MovingScene,
        SimulationSettings,
        SweepTiming,
        Waveform,
    )
    from clradar.model.progress import Progress
    from clradar.motion.motion_file import Motion

_STEPS = 1000
"""Of the progress of a frame."""


@dataclass(frozen=True, slots=True)
class MotionRecording:
    """What a recording is simulated from."""

    motion: Motion
    moving: MovingScene
    array: AntennaArray
    waveform: Waveform
    settings: SimulationSettings
    rate_hz: float

    def write(
        self,
        output: Path,
        n_frames: int | None,
        origin: Mapping[str, Any],
        device: Device,
        progress: Progress | None,
        *,
        force: bool,
    ) -> str:
        """Write a capture, or `n_frames` as a recording, whole or not at all; return it in words.

        One frame is in memory at a time.
        """
        from clradar.arrays import qar50
        from measurement_io import save_recording

        timing = self.motion.timing(self.array, self.waveform)
        sweep_s = timing.end_s - timing.begin_s
        words = f"sweeps of {1e3 * sweep_s:.3g} ms"
        if n_frames is None:
            (capture,) = self._captures(1, timing, device, progress)
            save(output, capture, origin, force=force)
            instants = capture.meta["movement"].get("instants", 1)
            return f"a sweep of {1e3 * sweep_s:.3g} ms, simulated at {instants} instants"
        if n_frames > 1 and sweep_s * self.rate_hz > 1.0:
            warn(
                f"a sweep takes {1e3 * sweep_s:.3g} ms, longer than the "
                f"{1e3 / self.rate_hz:.3g} ms between frames; lower --rate-hz, or give shorter "
                "times in the motion file"
            )
        frames = self._captures(n_frames, timing, device, progress)
        stamps_us = [round(1e6 * self._start_s(i)) for i in range(n_frames)]
        with whole_folder(output, force=force, replaced=replaced_in(output)) as made:
            if self.array.same_positions(qar50()):
                described_frames = (described(capture, origin) for capture in frames)
                save_recording(made, described_frames, timestamps_us=stamps_us)
            else:
                for i, capture in enumerate(frames):
                    save(made / f"{i:06d}.h5", capture, origin, force=False)
            (made / TRUTH).mkdir()
            truth = {"frames": self._truth(stamps_us, timing), **origin}
            write_json(made / TRUTH / "truth.json", truth, force=False)
        return f"{n_frames} frames, {words}"

    def _start_s(self, frame: int) -> float:
        return frame / self.rate_hz

    def _captures(
        self, n_frames: int, timing: SweepTiming, device: Device, progress: Progress | None
    ) -> Iterator[Capture]:
        from clradar import simulate_moving

        for i in range(n_frames):

            def show(done: int, total: int, i: int = i) -> None:
                if progress is not None:
                    progress(i * _STEPS + _STEPS * done // total, n_frames * _STEPS)

            capture = simulate_moving(
                self.moving, self.array, self.waveform, timing=timing, start_s=self._start_s(i),
                settings=self.settings, device=device, progress=show,
            )  # fmt: skip
            stamp_us = round(1e6 * self._start_s(i))
            yield replace(capture, meta={**capture.meta, "frame": i, "timestamp_us": stamp_us})

    def _truth(self, stamps_us: list[int], timing: SweepTiming) -> list[dict[str, Any]]:
        """Where everything is in the middle of each sweep."""
        from clradar.cli.region_files import joints_record
        from clradar.motion.hands import MovingHand

        frames = []
        hands = [body for body in self.moving.bodies if isinstance(body, MovingHand)]
        for i, stamp_us in enumerate(stamps_us):
            middle_s = self._start_s(i) + 0.5 * (timing.begin_s + timing.end_s)
            bodies = {name: m.at(middle_s).tolist() for name, m in self.motion.bodies.items()}
            frames.append(
                {
                    "frame": i,
                    "timestamp_us": stamp_us,
                    "middle_s": middle_s,
                    "bodies": bodies,
                    "hands": [
                        {
                            "pose": hand.pose(middle_s).name,
                            "transform": hand.transform(middle_s).tolist(),
                            "joints_m": joints_record(hand.joints_m(middle_s)),
                        }
                        for hand in hands
                    ],
                }
            )
        return frames

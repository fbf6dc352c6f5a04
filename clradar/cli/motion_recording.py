"""The recording of a scene that moves, frame by frame, with its truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.options.motion import CLUSTER_NAME, TRUTH, replaced_in
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
    """What a recording is simulated from; of several clusters each has its own."""

    motion: Motion
    moving: MovingScene
    clusters: Sequence[AntennaArray]
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

        Of several clusters a folder of them. One frame is in memory at a time.
        """
        from measurement_io import save_recording

        timings = self.motion.timings(self.clusters, self.waveform)
        sweep_s = max(t.end_s for t in timings) - min(t.begin_s for t in timings)
        if n_frames is not None and n_frames > 1 and sweep_s * self.rate_hz > 1.0:
            warn(
                f"a sweep takes {1e3 * sweep_s:.3g} ms, longer than the "
                f"{1e3 / self.rate_hz:.3g} ms between frames; lower --rate-hz, or give shorter "
                "times in the motion file"
            )
        several = len(self.clusters) > 1
        if n_frames is None and not several:
            (capture,) = self._captures(0, 1, timings[0], device, progress)
            save(output, capture, origin, force=force)
            instants = capture.meta["movement"].get("instants", 1)
            times = "1 instant" if instants == 1 else f"{instants} instants"
            return f"a sweep of {1e3 * sweep_s:.3g} ms, simulated at {times}"
        words = f"{n_frames} frames, sweeps" if n_frames is not None else "a sweep"
        words += f" of {1e3 * sweep_s:.3g} ms"
        if several:
            words += f", {len(self.clusters)} clusters"
        stamps_us = [round(1e6 * self._start_s(i)) for i in range(n_frames or 1)]
        with whole_folder(output, force=force, replaced=replaced_in(output)) as made:
            for number, timing in enumerate(timings):
                captures = self._captures(number, len(stamps_us), timing, device, progress)
                name = CLUSTER_NAME.format(number + 1)
                if n_frames is None:
                    save(made / f"{name}.h5", next(captures), origin, force=False)
                    continue
                folder = made / name if several else made
                described_frames = (described(capture, origin) for capture in captures)
                save_recording(folder, described_frames, timestamps_us=stamps_us, force=True)
                (folder / TRUTH).mkdir()
                truth = {"frames": self._truth(stamps_us, timing), **origin}
                write_json(folder / TRUTH / "truth.json", truth, force=False)
        return words

    def _start_s(self, frame: int) -> float:
        return frame / self.rate_hz

    def _captures(
        self,
        number: int,
        n_frames: int,
        timing: SweepTiming,
        device: Device,
        progress: Progress | None,
    ) -> Iterator[Capture]:
        """The frames of one cluster."""
        from clradar import simulate_moving

        total = n_frames * len(self.clusters)
        for i in range(n_frames):

            def show(done: int, of: int, i: int = i) -> None:
                if progress is not None:
                    before = number * n_frames + i
                    progress(before * _STEPS + _STEPS * done // of, total * _STEPS)

            capture = simulate_moving(
                self.moving, self.clusters[number], self.waveform, timing=timing,
                start_s=self._start_s(i), settings=self.settings, device=device, progress=show,
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

"""The recording of a moving hand, simulated frame by frame, and the truth of every frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.outputs import whole_folder
from clradar.cli.recording_conversion import described
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from clradar import AntennaArray, Capture, Device, Scene, SimulationSettings, Waveform
    from clradar.hand import HandMesh, HandMovement, HandPose
    from clradar.model.progress import Progress
    from clradar.opencl import Devices

TRUTH = "truth"
"""Folder beside the radar folder, with `TRUTH_FILE` and a pose file per frame."""

TRUTH_FILE = "truth.json"


@dataclass(frozen=True, slots=True)
class HandRecording:
    """What a recording is simulated from.

    Attributes
    ----------
    movement : HandMovement
    posed : callable
        The mesh of the hand in a pose, anywhere; meshed on a device.
    scene_of : callable
        The scene of a mesh: its alpha and materials.
    array : AntennaArray
    waveform : Waveform
    settings : SimulationSettings
        The same seed in all frames: the roughness of a material is that of one hand.
    snr_db : float or None
        Of noise that differs from frame to frame.
    """

    movement: HandMovement
    posed: Callable[[HandPose, Device], HandMesh]
    scene_of: Callable[[HandMesh], Scene]
    array: AntennaArray
    waveform: Waveform
    settings: SimulationSettings
    snr_db: float | None

    def write(
        self,
        folder: Path,
        origin: Mapping[str, Any],
        about: Mapping[str, Any],
        devices: Devices,
        progress: Progress | None,
        *,
        force: bool,
        replaced: Collection[str],
    ) -> Path:
        """Write `folder/radar_<low>_<high>_<points>` and `folder/truth`, whole or not at all.

        One frame is in memory at a time.

        Parameters
        ----------
        folder : Path
        origin : mapping
            From `clradar.cli.provenance.provenance`; part of every frame.
        about : mapping
            Entries of the truth file that are the same in all frames.
        devices : Devices
            Frames are divided among several, a few of them in memory then.
        progress : callable, optional
            Called with (done, total) frames.
        force, replaced
            As of `clradar.cli.outputs.check_folder`.

        Returns
        -------
        Path
            The radar folder.
        """
        from clradar.hand import write_pose
        from measurement_io import save_recording

        frames: list[dict[str, Any]] = []
        with whole_folder(folder, force=force, replaced=replaced) as made:
            radar = save_recording(
                made, self._captures(frames, origin, devices),
                timestamps_us=self.movement.timestamps_us, progress=progress,
            )  # fmt: skip
            (made / TRUTH).mkdir()
            for record, pose in zip(frames, self.movement.poses, strict=True):
                write_pose(made / TRUTH / record["pose"], pose)
            truth = {**about, "frames": frames, **origin}
            write_json(made / TRUTH / TRUTH_FILE, truth, force=False)
        return folder / radar.name

    def _captures(
        self, frames: list[dict[str, Any]], origin: Mapping[str, Any], devices: Devices
    ) -> Iterator[Capture]:
        """The frames one after the other; the truth of each is added to `frames`."""
        devices.check_alike("the frames of a recording")
        for capture, record in devices.in_order(_Frame(self), range(len(self.movement))):
            frames.append(record)
            yield described(capture, origin)


@dataclass(frozen=True, slots=True)
class _Frame:
    """A frame of a recording and its truth: work of `clradar.opencl.Devices`."""

    recording: HandRecording

    def __call__(
        self, i: int, device: Device, _: Progress
    ) -> Iterator[tuple[Capture, dict[str, Any]]]:
        from clradar import impair, simulate
        from clradar.cli.region_files import joints_record

        made, movement = self.recording, self.recording.movement
        mesh = movement.placed(i, made.posed(movement.poses[i], device))
        capture = simulate(
            made.scene_of(mesh), made.array, made.waveform, settings=made.settings, device=device
        )
        if made.snr_db is not None:
            capture = impair(capture, seed=made.settings.seed, frame=i, snr_db=made.snr_db)
        record = {
            "frame": i,
            "timestamp_us": movement.timestamps_us[i],
            "pose": f"{i:06d}.toml",
            "transform": movement.transforms[i].tolist(),
            "joints_m": joints_record(mesh.joints_m),
        }
        yield replace(capture, meta={**capture.meta, "frame": i}), record

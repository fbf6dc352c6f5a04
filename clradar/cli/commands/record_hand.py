"""``clradar record-hand``: simulate the recording of a moving hand, with its truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.console import print_line, progress_bar
from clradar.cli.options.alphas import AlphaOptions, read_part_alphas, with_part_alphas
from clradar.cli.options.common import DevicesOption, ForceOption
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option, recorded
from clradar.cli.options.hand import EmbeddedHandOptions
from clradar.cli.options.materials import PHYSICAL, MaterialOptions
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.rig import HAND_CREASE_DEG, RigOptions
from clradar.cli.options.simulation import (
    ESTIMATORS,
    Estimator,
    SamplingOptions,
)
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_folder
from clradar.cli.provenance import provenance
from clradar.errors import warn
from clradar.geometry.normals import CREASE_DEG

if TYPE_CHECKING:
    from clradar import Device, Scene, SimulationSettings
    from clradar.hand import HandMesh, HandMovement, HandPose, HandShape
    from clradar.rigs import Rig


@dataclass(frozen=True, kw_only=True)
class MovementOptions:
    """Poses over time, and the place of the hand."""

    poses: list[str] = argument(
        REQUIRED,
        "Poses in their order, each a name (`clradar hand --list`) or a pose file; a single one "
        "stays.",
        metavar="POSE...",
    )
    frames: int = option(20, "Frames; the last one has the last pose.", metavar="N")
    rate_hz: float = option(8.0, "Frames per second.", metavar="HZ")
    center_mm: tuple[float, float, float] = option(
        (0.0, 0.0, 300.0), "Centre of the box around the joints of all frames.", metavar="X Y Z"
    )
    shift_mm: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "The whole hand moves so far until the last frame.", metavar="X Y Z"
    )
    turn_deg: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0),
        "The whole hand turns so far until the last frame, about that centre: a rotation vector.",
        metavar="X Y Z",
    )

    @property
    def files(self) -> list[Path]:
        """The pose files."""
        return [Path(pose) for pose in self.poses if Path(pose).suffix]

    def movement(self, handedness: str, shape: HandShape) -> HandMovement:
        """Pose and place in every frame."""
        from clradar.hand import hand_movement

        return hand_movement(
            self.poses,
            self.frames,
            rate_hz=self.rate_hz,
            handedness=handedness,
            shape=shape,
            center_m=[value / 1e3 for value in self.center_mm],
            shift_m=[value / 1e3 for value in self.shift_mm],
            turn_rad=np.radians(self.turn_deg),
        )


@dataclass(frozen=True, kw_only=True)
class FieldOptions(SamplingOptions):
    """Estimator of the received field, and the random numbers of surface and noise."""

    estimator: Estimator | None = option(
        None,
        f"{ESTIMATORS} [default: physical with --material, stochastic with samples or rays, else "
        "expected]",
    )
    seed: int = option(
        0, "Same seed, same device: same bits. One surface in all frames.", metavar="N"
    )
    snr_db: float = option(20.0, "Noise, another in every frame; inf: none.", metavar="DB")

    def settings(self, made_of: MaterialOptions, rigged: RigOptions) -> SimulationSettings:
        """The settings of the simulation."""
        from clradar import SimulationSettings

        return SimulationSettings(
            samples_per_mm2=self.samples_per_mm2,
            rays_per_sample=self.rays_per_sample,
            estimator=made_of.estimator(self.estimator),
            crease_deg=CREASE_DEG if rigged.rig is None else HAND_CREASE_DEG,
            seed=self.seed,
        )

    @property
    def noise_db(self) -> float | None:
        """Signal-to-noise ratio, dB; None: no noise."""
        return self.snr_db if np.isfinite(self.snr_db) else None


def command(
    moving: MovementOptions,
    output: Path = output_option(REQUIRED, "Folder to make: the recording and its truth."),
    *,
    embedded: EmbeddedHandOptions,
    rigged: RigOptions,
    alphas: AlphaOptions,
    made_of: MaterialOptions,
    field: FieldOptions,
    radar: RadarOptions,
    device: DevicesOption = None,
    force: ForceOption = False,
) -> None:
    """Between two poses the joint angles go from rest to rest (minimum jerk). Each frame is a still
    hand: movement while a frame is recorded is not simulated.

    The folder holds a recording as the imager writes it, which every command reads, and truth/:
    truth.json with the joints and the transform of each frame, and a pose file for each.
    """
    from clradar.cli.hand_recording import TRUTH, HandRecording
    from clradar.opencl import open_devices

    default, by_part = read_part_alphas(alphas.alpha or [])
    _check(rigged, embedded, device)
    inputs = [*moving.files, *rigged.files, *made_of.files, *radar.files]
    replaced = [TRUTH, *(path.name for path in output.glob("radar_*"))]
    check_folder(output, force=force, replaced=replaced, inputs=inputs)
    settings = field.settings(made_of, rigged)
    if settings.estimator == PHYSICAL and alphas.alpha:
        warn(f"--alpha: not used by --estimator {PHYSICAL}; --material has the roughness")
    rig = None if rigged.rig is None else rigged.read()
    handedness = embedded.handedness if rig is None else rig.handedness
    movement = moving.movement(handedness, embedded.shape)
    devices = open_devices(device)
    start_s = perf_counter()
    recording = HandRecording(
        movement,
        _Posed(embedded, rig),
        _Scenes(made_of, default, by_part),
        radar.antennas(),
        radar.waveform(),
        settings,
        field.noise_db,
    )
    options = recorded(moving, embedded, rigged, alphas, made_of, field, radar)
    options["snr_db"] = field.noise_db
    about = {"handedness": handedness, **_hand_record(embedded, rigged)}
    with progress_bar("simulating") as progress:
        written = recording.write(
            output, provenance("record-hand", options, inputs), about, devices, progress,
            force=force, replaced=replaced,
        )  # fmt: skip
    took_s = perf_counter() - start_s
    print_line(f"{written}: {len(movement)} frames, {took_s:.1f} s on {devices.text}")
    print_line(f"{output / TRUTH}: their joints, transforms and poses")


@dataclass(frozen=True, slots=True)
class _Posed:
    """Meshes of the hand: the embedded one, or a rig."""

    embedded: EmbeddedHandOptions
    rig: Rig | None

    def __call__(self, pose: HandPose, device: Device) -> HandMesh:
        if self.rig is not None:
            return self.rig.posed(pose)
        return self.embedded.posed(pose, (0.0, 0.0, 0.3), device)


@dataclass(frozen=True, slots=True)
class _Scenes:
    """Scenes of meshes: with the alphas and materials of the options."""

    made_of: MaterialOptions
    alpha: float
    by_part: Mapping[str, float]

    def __call__(self, mesh: HandMesh) -> Scene:
        from clradar import Scene

        return self.made_of.on(
            with_part_alphas(Scene.from_mesh(mesh, alpha=self.alpha), self.by_part)
        )


def _check(rigged: RigOptions, embedded: EmbeddedHandOptions, device: str | None) -> None:
    """Raise unless the options of the hand go together."""
    if rigged.theta is not None:
        raise wrong_usage("--theta", "a moving hand goes from pose to pose")
    if rigged.rig is not None:
        for name in given(embedded):
            raise wrong_usage(name, "a rig keeps mesh, size and side as it is; see --rig-hand")


def _hand_record(embedded: EmbeddedHandOptions, rigged: RigOptions) -> dict[str, Any]:
    if rigged.rig is not None:
        return {"rig": rigged.rig.name}
    return {"shape": asdict(embedded.shape)}

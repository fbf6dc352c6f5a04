"""The demonstration: the embedded hand simulated, imaged and compared with a synthetic measurement.

The experiment is that of figure 4 in J. Braeunig et al., "A Realistic Radar Ray Tracing Simulator
for Hand Pose Imaging", EuRAD 2023.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from clradar import Capture, Device, Scene, VoxelGrid, simulate
from clradar.cli.comparison import Comparison, figure_labels
from clradar.cli.console import print_line, progress_bar
from clradar.cli.hand_mesh import save_hand, turned
from clradar.cli.inputs import form_image
from clradar.cli.options.groups import recorded
from clradar.cli.options.imaging import ImagingOptions
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.recording import recording_files
from clradar.cli.outputs import save
from clradar.cli.provenance import provenance
from clradar.errors import OutputError
from clradar.files.json_file import write_json
from clradar.hand import hand_mesh
from clradar.hand.flesh import PART_NAMES
from clradar.hand.mesh import DEFAULT_CENTER_M
from measurement_io import open_capture, save_maroon_frame

HAND, FLAT_HAND = "hand_f.ply", "hand_flat.ply"
MEASUREMENT = "measurement"
FIGURE, METRICS = "comparison.png", "metrics.json"
PHYSICAL = "physical"
MATERIALS = {part: "palm" if part == "palm" else "skin" for part in PART_NAMES}


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """Settings of the demonstration.

    Attributes
    ----------
    voxel_m : float, metres
        Of the volume x, y = -100 ... 100 mm, z = 260 ... 340 mm.
    alphas : tuple of float
        One simulated capture each.
    rays : mapping
        Settings of these simulations, by name; those that `clradar.simulate` chooses if empty.
    materials : mapping
        Of the parts of the hand, for the physical estimator.
    seed, measured_seed, noise_seed : int
    snr_db : float
        Of the synthetic measurement: see `with_noise`.
    turn_deg : float, degrees
        How far the hands are turned about the vertical. At 0 the palm is a mirror that faces the
        aperture and outshines the fingers by about 15 dB at alpha 0; turned by more than
        atan(7 / 30), 13 degrees, it glints past the aperture's edge, while upright fingers glint as
        before.
    array, band : str, optional
        Of `RadarOptions`.
    """

    voxel_m: float
    alphas: tuple[float, ...] = (0.0, 0.5, 1.0)
    rays: Mapping[str, Any] = field(default_factory=dict)
    materials: Mapping[str, str] = field(default_factory=lambda: MATERIALS)
    seed: int = 0
    measured_seed: int = 1
    noise_seed: int = 2
    snr_db: float = 20.0
    turn_deg: float = 25.0
    array: str | None = None
    band: str | None = None

    @property
    def radar(self) -> RadarOptions:
        """Antennas and frequencies."""
        return RadarOptions(array=self.array, band=self.band)

    def grid(self) -> VoxelGrid:
        """The volume of the paper's experiment, with voxels of `voxel_m`."""
        return VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), self.voxel_m)


DEFAULT = DemoSettings(voxel_m=2e-3)
FULL = DemoSettings(voxel_m=1e-3)


@dataclass(slots=True)
class _Stages:
    """Times every stage and prints one line for each as it ends."""

    times_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start_s = perf_counter()
        yield
        took_s = perf_counter() - start_s
        self.times_s[name] = round(took_s, 3)
        print_time(name, took_s)


def print_time(name: str, time_s: float) -> None:
    """Print one row of the table of times."""
    print(f"  {name:<54}{f'{time_s:6.1f} s':>10}", flush=True)


def with_noise(capture: Capture, snr_db: float, seed: int) -> Capture:
    """Add complex white Gaussian noise to a capture.

    Parameters
    ----------
    capture : Capture
    snr_db : float, decibel
        Mean of |s|^2 over all pairs and frequencies of `capture`, over the noise's variance
        E|n|^2.
    seed : int
        Of numpy's Philox generator: the same seed gives the same noise.

    Returns
    -------
    Capture
        With both numbers in `meta`.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    power = float(np.mean(np.abs(capture.data) ** 2, dtype=np.float64))
    sigma = np.sqrt(0.5 * power * 10.0 ** (-snr_db / 10.0))
    parts = rng.standard_normal((*capture.data.shape, 2), dtype=np.float32) * np.float32(sigma)
    noise = parts.view(np.complex64)[..., 0]
    meta = {**capture.meta, "noise": {"snr_db": snr_db, "seed": seed, "generator": "Philox"}}
    return Capture(capture.data + noise, capture.array, capture.waveform, meta)


def run_demo(folder: Path, settings: DemoSettings, device: Device) -> None:
    """Run every stage and write its files into `folder`.

    Parameters
    ----------
    folder : Path
        Exists; files of an earlier demo in it are replaced.
    settings : DemoSettings
    device : Device
    """
    stages = _Stages()
    with stages.stage("meshes: hand F and flat"):
        for name, pose in ((HAND, "F"), (FLAT_HAND, "flat")):
            mesh = turned(hand_mesh(pose, device=device), settings.turn_deg, DEFAULT_CENTER_M)
            save_hand(folder / name, mesh, force=True)
    # From the file, so that `clradar simulate` on it gives the captures of the demo.
    scene = Scene.from_mesh(folder / HAND)
    options = recorded(settings)
    origin = provenance("demo", options, [folder / HAND])

    captures: dict[str, Capture] = {}
    made_of = scene.with_material(settings.materials)
    named = {f"alpha_{a:g}": (scene.with_alpha(a), settings.rays) for a in settings.alphas}
    named[PHYSICAL] = (made_of, {"estimator": PHYSICAL})
    for name, (surface, rays) in named.items():
        with stages.stage(f"simulate {name}"):
            capture = _simulated(surface, settings, settings.seed, rays, device)
            captures[name] = save(folder / f"{name}.h5", capture, origin, force=True)
    with stages.stage("simulate the measurement, physical, and noise"):
        measured = _measured(folder / MEASUREMENT, made_of, settings, device)

    grid = settings.grid()
    volumes = []
    for name, capture in {MEASUREMENT: measured, **captures}.items():
        with stages.stage(f"image of {name}"):
            volume = form_image(capture, grid, ImagingOptions(), device, f"imaging {name}")
            source = folder / (name if name == MEASUREMENT else f"{name}.h5")
            files = recording_files(source, capture.meta)
            image_origin = provenance("demo", options, files)
            volumes.append(save(_volume_file(folder, name), volume, image_origin, force=True))

    with stages.stage("metrics and figure"):
        paths = [_volume_file(folder, name) for name in captures]
        compared = Comparison.of(volumes, figure_labels(paths, [v.meta for v in volumes[1:]]))
        label = "Synthetic measurement"
        compared.save_figure(folder / FIGURE, force=True, measured_label=label)
        record = {
            "measured": _volume_file(folder, MEASUREMENT).name,
            "simulated": compared.records([Path(path.name) for path in paths]),
            "times_s": stages.times_s,
            **origin,
            "device": dict(device.describe()),
        }
        write_json(folder / METRICS, record, force=True)
    print_time("total", sum(stages.times_s.values()))
    print(flush=True)
    compared.print()
    print_line(f"{folder / FIGURE}: the synthetic measurement beside the simulated images")


def _volume_file(folder: Path, name: str) -> Path:
    return folder / f"{name}_volume.h5"


def _simulated(
    scene: Scene, settings: DemoSettings, seed: int, rays: Mapping[str, Any], device: Device
) -> Capture:
    with progress_bar("tracing") as progress:
        return simulate(
            scene,
            settings.radar.antennas(),
            settings.radar.waveform(),
            seed=seed,
            device=device,
            progress=progress,
            **rays,
        )


def _measured(folder: Path, scene: Scene, settings: DemoSettings, device: Device) -> Capture:
    """The synthetic measurement, read from the recording that is written first."""
    clean = _simulated(scene, settings, settings.measured_seed, {"estimator": PHYSICAL}, device)
    noisy = with_noise(clean, settings.snr_db, settings.noise_seed)
    save_maroon_frame(folder, noisy, force=True)
    recorded_frame = open_capture(folder)
    if not np.array_equal(recorded_frame.data, noisy.data):
        raise OutputError(f"{folder}: reads back other values than were written")
    return recorded_frame

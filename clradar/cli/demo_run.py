"""The main job end to end on the embedded hand: what ``clradar demo`` does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter

import numpy as np

from clradar import (
    AntennaArray,
    Capture,
    Device,
    Scene,
    VoxelGrid,
    Waveform,
    arrays,
    compare,
    simulate,
)
from clradar.cli.compare import metrics_records, print_metrics
from clradar.cli.hand import save_hand, turned
from clradar.cli.images import form_image, labels_of, recording_files, save_image
from clradar.cli.output import print_line, progress_bar, write_json
from clradar.cli.provenance import provenance
from clradar.cli.simulate import save_with_provenance
from clradar.errors import OutputError
from clradar.geometry.bvh import face_normals
from clradar.hand import hand_mesh
from clradar.hand.mesh import DEFAULT_CENTER_M
from clradar.plot import comparison_figure, save_figure
from measurement_io import open_capture, save_maroon_frame

HAND, FLAT_HAND = "hand_f.ply", "hand_flat.ply"
MEASUREMENT = "measurement"
FIGURE, METRICS = "comparison.png", "metrics.json"


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """What the demo runs.

    Attributes
    ----------
    samples : int
        Surface samples per capture.
    rays_per_sample : int
    voxel_m : float, metres
        Of the volume x, y = -100 ... 100 mm, z = 260 ... 340 mm.
    alphas : tuple of float
        One simulated capture each.
    measured_alpha : float
    seed, measured_seed, noise_seed : int
    snr_db : float
        Of the synthetic measurement: see `with_noise`.
    turn_deg : float, degrees
        How far the hands are turned about the vertical. At 0 the palm is a mirror that faces the
        aperture and outshines the fingers by about 15 dB at alpha 0; turned by more than
        atan(7 / 30), 13 degrees, it glints past the aperture's edge, while upright fingers glint as
        before.
    """

    samples: int
    rays_per_sample: int
    voxel_m: float
    alphas: tuple[float, ...] = (0.0, 0.5, 1.0)
    measured_alpha: float = 0.3
    seed: int = 0
    measured_seed: int = 1
    noise_seed: int = 2
    snr_db: float = 20.0
    turn_deg: float = 25.0

    def grid(self) -> VoxelGrid:
        """Return the voxels of the paper's experiment, `voxel_m` apart."""
        return VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), self.voxel_m)


DEFAULT = DemoSettings(samples=400_000, rays_per_sample=4, voxel_m=2e-3)
FULL = DemoSettings(samples=400_000, rays_per_sample=4, voxel_m=1e-3)


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
        print_line_aligned(name, f"{took_s:6.1f} s")


def print_line_aligned(name: str, value: str) -> None:
    """Print one row of the table of times."""
    print(f"  {name:<54}{value:>10}", flush=True)


def prepare_folder(folder: Path, *, force: bool) -> None:
    """Make the demo's folder; raise unless it is empty or `force` is set."""
    try:
        if folder.is_dir():
            if any(folder.iterdir()) and not force:
                raise OutputError(
                    f"{folder}: holds files already; choose another folder with -o, or --force"
                )
        else:
            folder.mkdir(parents=True)
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{folder}: cannot be made: {error}") from error


def with_noise(capture: Capture, snr_db: float, seed: int) -> Capture:
    """Return a capture with complex white Gaussian noise.

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
    array, waveform = arrays.qar50(), Waveform.sfcw(72e9, 82e9, 128)
    with stages.stage("meshes: hand F and flat"):
        for name, pose in ((HAND, "F"), (FLAT_HAND, "flat")):
            mesh = turned(hand_mesh(pose, device=device), settings.turn_deg, DEFAULT_CENTER_M)
            save_hand(folder / name, mesh, force=True)
    # From the file, so that `clradar simulate` on it gives what the demo has.
    scene = Scene.from_mesh(folder / HAND)

    captures = []
    for alpha in settings.alphas:
        with stages.stage(f"simulate alpha = {alpha:g}"):
            captures.append(_simulated(folder, scene, alpha, settings, array, waveform, device))
    with stages.stage(f"simulate the measurement, alpha = {settings.measured_alpha:g}, and noise"):
        measured = _measured(folder, scene, settings, array, waveform, device)

    grid = settings.grid()
    volumes = []
    for name, capture in zip(_names(settings), [measured, *captures], strict=True):
        with stages.stage(f"image of {name}"):
            volume = form_image(capture, grid, "fast", "rect", device, f"imaging {name}")
            target = folder / f"{name}_volume.h5"
            source = folder / (MEASUREMENT if name == MEASUREMENT else f"{name}.h5")
            inputs = recording_files(source, capture.meta)
            save_image(target, volume, "demo", asdict_json(settings), inputs, force=True)
            volumes.append(volume)

    with stages.stage("metrics and figure"):
        maps = [volume.depth_map() for volume in volumes]
        paths = [folder / f"{name}_volume.h5" for name in _names(settings)[1:]]
        labels = labels_of(paths, [volume.meta for volume in volumes[1:]])
        metrics = [compare(maps[0], m) for m in maps[1:]]
        columns = list(zip(labels, maps[1:], strict=True))
        save_figure(
            comparison_figure(
                maps[0],
                columns,
                metrics=metrics,
                measured_label="Synthetic measurement",
            ),
            folder / FIGURE,
            force=True,
        )
        record = {
            "measured": f"{MEASUREMENT}_volume.h5",
            "simulated": metrics_records([Path(p.name) for p in paths], labels, metrics),
            "times_s": stages.times_s,
            **provenance("demo", asdict_json(settings), [folder / HAND]),
            "device": dict(device.describe()),
        }
        write_json(folder / METRICS, record, force=True)
    print_line_aligned("total", f"{sum(stages.times_s.values()):6.1f} s")
    print(flush=True)
    print_metrics(labels, metrics)
    print_line(f"{folder / FIGURE}: the synthetic measurement beside the simulated images")


def _names(settings: DemoSettings) -> list[str]:
    return [MEASUREMENT, *(f"alpha_{alpha:g}" for alpha in settings.alphas)]


def asdict_json(settings: DemoSettings) -> dict[str, object]:
    """Return the settings in types that JSON reads back as they were."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(settings).items()}


def _traced(
    scene: Scene,
    alpha: float,
    seed: int,
    settings: DemoSettings,
    array: AntennaArray,
    waveform: Waveform,
    device: Device,
) -> Capture:
    area_mm2 = 1e6 * float(face_normals(scene.triangles_m)[1].sum())
    with progress_bar(f"tracing alpha = {alpha:g}") as progress:
        return simulate(
            scene.with_alpha(alpha),
            array,
            waveform,
            samples_per_mm2=settings.samples / area_mm2,
            rays_per_sample=settings.rays_per_sample,
            seed=seed,
            device=device,
            progress=progress,
        )


def _simulated(
    folder: Path,
    scene: Scene,
    alpha: float,
    settings: DemoSettings,
    array: AntennaArray,
    waveform: Waveform,
    device: Device,
) -> Capture:
    capture = _traced(scene, alpha, settings.seed, settings, array, waveform, device)
    options = asdict_json(settings)
    target = folder / f"alpha_{alpha:g}.h5"
    return save_with_provenance(target, capture, "demo", options, [folder / HAND], force=True)


def _measured(
    folder: Path,
    scene: Scene,
    settings: DemoSettings,
    array: AntennaArray,
    waveform: Waveform,
    device: Device,
) -> Capture:
    """Return the synthetic measurement, read from the recording that is written first."""
    clean = _traced(
        scene, settings.measured_alpha, settings.measured_seed, settings, array, waveform, device
    )
    noisy = with_noise(clean, settings.snr_db, settings.noise_seed)
    save_maroon_frame(folder / MEASUREMENT, noisy, force=True)
    recorded = open_capture(folder / MEASUREMENT)
    if not np.array_equal(recorded.data, noisy.data):
        raise OutputError(f"{folder / MEASUREMENT}: reads back other values than were written")
    return recorded

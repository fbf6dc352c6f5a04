"""``clradar demo``: figure 4 of J. Braeunig et al., "A Realistic Radar Ray Tracing Simulator for
Hand Pose Imaging", EuRAD 2023.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.comparison import Comparison, figure_labels
from clradar.cli.console import print_line, progress_bar
from clradar.cli.outputs import check_folder, turned, write
from clradar.jobs import open_devices
from clradar.jobs.lock import made_folder

TURN_DEG = 25.0
"""At 0 the palm is a mirror, which outshines the fingers by about 15 dB at alpha 0; from
atan(7 / 30), 13 degrees, on it glints past the aperture's edge."""

MEASUREMENT, PHYSICAL, SNR_DB = "measurement", "physical", 20.0


def command(
    *,
    output: Path = opt.output_option(
        "Folder to make, or an empty one.", Path("demo"), metavar="DIR", folder=True
    ),
    full: bool = opt.option("The paper's volume: 201 x 201 x 81 voxels of 1 mm.", False),
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.option("Write into a folder that holds files already.", False),
) -> None:
    """The letter F at alpha 0, 0.5 and 1, and of the materials palm and skin, is compared with a
    synthetic measurement: those materials, another seed, noise at an SNR of 20 dB, written and read
    in the file format of the instrument. The hand is turned by 25 degrees, so that the palm does
    not outshine the fingers.
    """
    radar.antennas()  # wrong usage is reported before anything is made
    check_folder(output)
    opened = open_devices(device).first
    voxel_m = 1e-3 if full else 2e-3
    grid = cl.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), voxel_m)
    print_line(f"device: {opened.info.label}")
    print_line(f"grid: {opt.grid_text(grid)}; --full has 1 mm")
    with made_folder(output):
        run_demo(output, radar, grid, opened)


def run_demo(
    folder: Path, radar: opt.RadarOptions, grid: cl.VoxelGrid, device: cl.Device, **rays: Any
) -> None:
    """Write the files of the demonstration over those of an earlier one; `rays` over alpha."""
    from clradar.hand import hand_mesh
    from clradar.hand.flesh import PART_NAMES
    from clradar.hand.mesh import DEFAULT_CENTER_M
    from measurement_io import open_capture, save_recording

    mesh, physical = folder / "hand_f.ply", {"estimator": PHYSICAL}
    write(mesh, turned(hand_mesh("F", device=device), TURN_DEG, DEFAULT_CENTER_M), force=True)
    scene = cl.Scene.from_mesh(mesh)  # as `clradar simulate` has it
    skin = scene.with_material({p: "palm" if p == "palm" else "skin" for p in PART_NAMES})
    opt.call.inputs["hand"] = [mesh]
    how: dict[str, Any] = {"force": True, "rays": rays, "grid": opt.grid_text(grid)}
    simulated: dict[str, Any] = {
        MEASUREMENT: (skin, physical, 1),
        **{f"alpha_{a:g}": (scene.with_alpha(a), rays, 0) for a in (0.0, 0.5, 1.0)},
        PHYSICAL: (skin, physical, 0),
    }
    volumes = []
    for name, (surface, settings, seed) in simulated.items():
        start_s = perf_counter()
        with progress_bar(f"simulating {name}") as progress:
            capture = cl.simulate(
                surface, radar.antennas(), radar.waveform(), seed=seed, device=device,
                progress=progress, **settings,
            )  # fmt: skip
        if name == MEASUREMENT:
            noisy = cl.impair(capture, seed=2, snr_db=SNR_DB)
            save_recording(folder / name, [noisy], force=True)
            capture = open_capture(folder / name)
        else:
            capture = write(folder / f"{name}.h5", capture, **how)
        with progress_bar(f"imaging {name}") as progress:
            image = cl.backproject(capture, grid, device=device, progress=progress)
        volumes.append(write(folder / f"{name}_volume.h5", image, **how))
        print_line(f"{name}: simulated and imaged in {perf_counter() - start_s:.1f} s")
    first, *paths = (Path(f"{name}_volume.h5") for name in simulated)
    compared = Comparison.of(volumes, figure_labels(paths, [v.meta for v in volumes[1:]]))
    found = {"measured": str(first), "simulated": compared.records(paths)}
    write(folder / "metrics.json", {**found, "device": device.describe()}, **how)
    compared.print()
    figure = partial(compared.figure, measured_label="Synthetic measurement")
    text = "the synthetic measurement beside the simulated images"
    write(folder / "comparison.png", figure, text, force=True)

"""``clradar demo``: simulate, image and compare the embedded hand, with figure and metrics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from clradar.cli.console import print_line
from clradar.cli.opening import open_written
from clradar.cli.options.common import DeviceOption, OpenOption
from clradar.cli.options.groups import option, output_option
from clradar.cli.options.imaging import grid_text
from clradar.cli.options.radar import RadarOptions
from clradar.cli.outputs import check_folder, made_folder


def command(
    *,
    output: Path = output_option(Path("demo"), "Folder to make, or an empty one.", metavar="DIR"),
    full: bool = option(False, "The paper's volume: 201 x 201 x 81 voxels of 1 mm."),
    estimator: Literal["expected", "stochastic"] | None = option(
        None,
        "Of the images over alpha: stochastic is the paper's. [default: as `clradar simulate`]",
    ),
    radar: RadarOptions,
    device: DeviceOption = None,
    force: bool = option(False, "Write into a folder that holds files already."),
    show: OpenOption = False,
) -> None:
    """Simulates the letter F at alpha 0, 0.5 and 1, and by the physical estimator with the
    materials palm and skin, forms the images, and compares them with a synthetic measurement: the
    physical estimator, another seed, and complex white Gaussian noise at an SNR of 20 dB. The SNR
    is the mean of |s|^2 over all pairs and frequencies of the noise-free capture over the variance
    of the noise. The measurement is saved and read again in the file format of the instrument.

    The hand is turned by 25 degrees (`clradar hand F --turn-deg 25`), so that the glint of the palm
    does not outshine the fingers.

    Voxels of 2 mm, to take less than a minute on two cores; --full forms the paper's volume of 1 mm
    voxels.
    """
    from clradar import open_device
    from clradar.cli import demonstration

    settings = demonstration.FULL if full else demonstration.DEFAULT
    settings = replace(settings, array=radar.array, band=radar.band)
    radar.antennas()  # wrong usage is reported before anything is made
    if estimator is not None:
        settings = replace(settings, rays={"estimator": estimator})
    check_folder(output, force=force)
    opened = open_device(device)
    print_line(f"device: {opened.info.label}")
    print_line(grid_text(settings.grid()))
    if not full:
        print_line("voxels of 2 mm where the paper's experiment has 1 mm: --full forms those")
    with made_folder(output):
        demonstration.run_demo(output, settings, opened)
    open_written(show, output / demonstration.FIGURE)

"""``clradar fit-hand``: find the pose of a measured hand, joint by joint, and simulate it there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.console import print_line, progress_bar
from clradar.cli.hand_fit_folder import FIGURE, FILES, FittedImages, print_fit, write_fit
from clradar.cli.hand_sequence import FIGURE as MOVEMENT
from clradar.cli.hand_sequences import fit_sequences
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.opening import open_written
from clradar.cli.options.common import (
    DevicesOption,
    ForceOption,
    OpenOption,
    SearchOptions,
)
from clradar.cli.options.groups import REQUIRED, argument, given, option, output_option, recorded
from clradar.cli.options.hand import ShapeOptions
from clradar.cli.options.imaging import GridOptions, ImagingOptions, grid_text
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.rig import RigFileOptions
from clradar.cli.options.sequence import SequenceOptions
from clradar.cli.options.values import FIT, alpha_or_fit, wrong_usage
from clradar.cli.outputs import check_folder, whole_folder
from clradar.cli.provenance import provenance

if TYPE_CHECKING:
    from calibration.hand_fit.starts import Start


@dataclass(frozen=True, kw_only=True)
class HandFitOptions(SearchOptions):
    """Where the fit starts, what it fits, and how it searches."""

    pose: str = option(
        "all",
        "Where the fit starts: a name (`clradar hand --list`), a pose file (.toml, .json), the "
        "folder of an earlier fit, a learned start (.onnx), several of them with commas, or all: "
        "every letter.",
        names=("--pose", "--start"),
        metavar="POSE,...",
    )
    hand: Literal["right", "left", "either"] | None = option(
        None, "Which hand it is. [default: right; that of an earlier fit, or of the rig]"
    )
    fit_shape: bool = option(False, "Fit size and proportions of the hand, too.")
    alpha: str = option(
        FIT,
        "0 specular to 1 diffuse, or fit: found from how the brightness falls with the angle.",
        metavar="ALPHA|fit",
    )
    quick: bool = option(
        False,
        "Without the simulations that correct the bias and find alpha: less exact where the hand "
        "is specular.",
    )
    angle_std_deg: float = option(
        12.0,
        "How far joints are from those of the starting pose: standard deviation of flexion and of "
        "the thumb; less at the joints that move less.",
        metavar="DEG",
    )
    seed: int = option(0, "Of all that is drawn.", metavar="N")

    @property
    def poses(self) -> list[str]:
        """The starts, one by one; a comma in the name of a file that exists separates nothing."""
        return [self.pose] if Path(self.pose).exists() else self.pose.split(",")

    @property
    def files(self) -> list[Path]:
        """The files of the starts."""
        from calibration.hand_fit.starts import start_file

        return [path for text in self.poses if (path := start_file(text)) is not None]

    def starts(self) -> tuple[Start, ...]:
        """The starts; an earlier fit has to be of the hand that was given, if it was."""
        from calibration.hand_fit.starts import starts_of

        starts = starts_of(self.poses)
        for start in starts:
            if self.hand is not None and start.handedness not in (None, self.hand):
                raise wrong_usage(
                    "--hand", f"expected {start.handedness}, as in --pose, got '{self.hand}'"
                )
        return starts


def command(
    *,
    measured: list[Path] = argument(
        REQUIRED,
        "Volume, capture or recording; several recordings with --frames.",
        metavar="MEASURED...",
    ),
    output: Path = output_option(REQUIRED, "New folder.", metavar="DIR"),
    fitting: HandFitOptions,
    shape: ShapeOptions,
    rigged: RigFileOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    frame: FrameOptions,
    sequence: SequenceOptions,
    radar: RadarOptions,
    device: DevicesOption = None,
    force: ForceOption = False,
    show: OpenOption = False,
) -> None:
    """Joint angles within their limits, place, alpha, and with --fit-shape the hand's size, so that
    the hand looks like MEASURED. No mesh is needed. DIR gets pose.toml (for `clradar hand` and data
    sets), placed.ply (for `clradar simulate`), fit.json with what the measurement tells and what
    not, the hand's simulation (capture.h5, volume.h5), two pictures and the metrics: all or
    nothing. Captures are imaged first, on the grid of the options. See docs/hand-fit.md.

    With --frames each frame of a recording is fitted from the one before, without simulations; DIR
    gets frames/, a table and figures over time, and resumes. Of several recordings each gets a
    folder in DIR. See docs/hand-movement.md.
    """
    from calibration import fit_hand
    from clradar import open_device

    read = [*fitting.files, *rigged.files, *radar.files]
    if sequence.of_frames(measured):
        if given(radar):
            raise wrong_usage(", ".join(given(radar)), "a recording has its antennas")
        made_by = recorded(fitting, shape, rigged, imaging, frame, voxels)
        folders = fit_sequences(
            sequence, measured, output, frame, voxels, imaging,
            settings=sequence_settings(fitting, shape, rigged),
            origin=provenance("fit-hand", made_by, read), device=device, force=force,
        )  # fmt: skip
        open_written(show, folders[0] / MOVEMENT)
        return
    source = measured[0]
    check_folder(output, force=force, replaced=FILES, inputs=[source, *read])
    settings = fit_settings(fitting, shape, rigged)
    voxels.grid()  # wrong usage is reported before a file is read
    image = ImageInput.open(source, frame)
    instrument = image.radar_or(radar)
    opened = open_device(device)
    grid = common_grid(voxels, image, device=opened)
    volume = image.volume(grid, imaging, opened)
    with progress_bar("fitting") as progress:
        fit = fit_hand(volume, device=opened, progress=progress, **settings, **instrument)
    images = FittedImages.of(volume, fit, instrument, fitting.seed, opened)
    options = recorded(
        fitting,
        shape,
        rigged,
        imaging,
        frame,
        radar,
        measured=source,
        grid=grid_text(volume.grid),
    )
    origin = provenance("fit-hand", options, [*image.files, *read])
    with whole_folder(output, force=force, replaced=FILES) as made:
        write_fit(made, images, str(source), origin)
    print_fit(fit)
    print_line(f"{output}: {', '.join(FILES)}")
    open_written(show, output / FIGURE)


def sequence_settings(
    fitting: HandFitOptions, shape: ShapeOptions, rigged: RigFileOptions
) -> dict[str, Any]:
    """The arguments of `calibration.fit_hands`, which runs no simulations."""
    if fitting.alpha != FIT:
        raise wrong_usage("--alpha", "frames are fitted without simulations, which alpha is of")
    settings = fit_settings(fitting, shape, rigged)
    return {key: value for key, value in settings.items() if key not in ("alpha", "closed_loop")}


def fit_settings(
    fitting: HandFitOptions, shape: ShapeOptions, rigged: RigFileOptions
) -> dict[str, Any]:
    """The arguments of `calibration.fit_hand`."""
    from clradar.model import checks

    settings = {
        "pose": fitting.starts(),
        "fit_shape": fitting.fit_shape,
        "alpha": alpha_or_fit(fitting.alpha),
        "closed_loop": not fitting.quick,
        "angle_std_deg": checks.positive("--angle-std-deg", fitting.angle_std_deg),
        "search_deg": checks.positive("--search-deg", fitting.search_deg),
        "seed": fitting.seed,
    }
    if rigged.rig is None:
        known = shape.shape if given(shape) else None
        return {**settings, "handedness": fitting.hand or "right", "shape": known}
    for name in given(shape):
        raise wrong_usage(name, "a rig keeps its size and proportions")
    if fitting.fit_shape:
        raise wrong_usage("--fit-shape", "a rig keeps its size and proportions")
    if fitting.hand is not None:
        raise wrong_usage("--hand", "a rig is one hand: --rig-hand says which")
    rig = rigged.read()
    return {**settings, "rig": rig, "handedness": rig.handedness}

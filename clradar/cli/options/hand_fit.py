"""Options of the fit of a hand: where it starts, what it fits, and how it searches."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.options.common import SearchOptions
from clradar.cli.options.groups import given, option
from clradar.cli.options.hand import ShapeOptions
from clradar.cli.options.rig import RigFileOptions
from clradar.cli.options.values import FIT, alpha_or_fit, wrong_usage

if TYPE_CHECKING:
    from calibration.hand_fit.starts import Start


@dataclass(frozen=True, kw_only=True)
class AnyHandOptions:
    """What is known of the hand, of one image or over frames."""

    hand: Literal["right", "left", "either"] | None = option(
        None, "Which hand it is. [default: right; that of an earlier fit, or of the rig]"
    )
    fit_shape: bool = option(False, "Fit size and proportions of the hand, too.")
    angle_std_deg: float = option(
        12.0,
        "How far joints are from those of the starting pose: standard deviation of flexion and of "
        "the thumb; less at the joints that move less.",
        metavar="DEG",
    )
    seed: int = option(0, "Of all that is drawn.", metavar="N")


@dataclass(frozen=True, kw_only=True)
class HandFitOptions(AnyHandOptions, SearchOptions):
    """Where the fit starts, what it fits, and how it searches."""

    pose: str = option(
        "all",
        "Where the fit starts: a name (`clradar hand --list`), a pose file (.toml, .json), the "
        "folder of an earlier fit, a learned start (.onnx), several of them with commas, or all: "
        "every letter.",
        names=("--pose", "--start"),
        metavar="POSE,...",
    )
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

    @property
    def poses(self) -> list[str]:
        """The starts, one by one; a comma in the name of a file that exists separates nothing."""
        return [self.pose] if Path(self.pose).exists() else self.pose.split(",")

    @property
    def files(self) -> list[Path]:
        """The files of the starts."""
        from calibration.hand_fit.starts import start_file

        return [path for text in self.poses if (path := start_file(text)) is not None]

    @property
    def named(self) -> list[str | None]:
        """The starts by their names; None for those in files, which count by their content."""
        from calibration.hand_fit.starts import start_file

        return [text if start_file(text) is None else None for text in self.poses]

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

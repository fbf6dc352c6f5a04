"""Options of hands: shape, rigs of files, pose, and the fit of one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import clradar as cl
from clradar.cli import parse
from clradar.cli.groups import arguments_of, option, wrong_usage
from clradar.cli.options.measured import SearchOptions, own_option, rig_option
from clradar.model import checks


@dataclass(frozen=True, kw_only=True)
class ShapeOptions:
    """Size and proportions of the embedded hand."""

    length_mm: float | None = own_option("Wrist crease to middle fingertip. [default: 187.4]")
    breadth_mm: float | None = own_option("Across the knuckles. [default: 85.6]")
    finger_lengths: tuple[float, float, float, float, float] | None = own_option(
        "Thumb to little finger, relative to an average hand of this length.", metavar="T I M R P"
    )
    girth: float | None = own_option("Thickness, relative to an average hand of this breadth.")

    @property
    def shape(self) -> cl.hand.HandShape | None:
        """Length, breadth, finger lengths, girth, if there is one of them."""
        known = arguments_of(self, ShapeOptions)
        return cl.hand.HandShape(**known) if known else None


def _unit_of_rig(option: str, text: str) -> str | float:
    if text in cl.rigs.UNITS_M:
        return text
    values_mm = parse.numbers(text)
    if len(values_mm) != 1 or values_mm[0] <= 0:
        known = f"one of {', '.join(cl.rigs.UNITS_M)}, or a positive number of mm"
        raise wrong_usage(option, f"expected {known}, got '{text}'")
    return values_mm[0]


@dataclass(frozen=True, kw_only=True)
class RigOptions:
    rig: Path | None = option(
        "Pose this hand instead: skinned glTF (.glb, .gltf) or a MANO model (.pkl, .npz).",
        metavar="HAND",
        needs="--fit-hand",
    )
    mapping: Path | None = rig_option(
        "Which node is which joint, without WebXR names: a table [joints].", metavar="M.toml"
    )
    rig_unit: str | float | None = rig_option(
        "m, cm, mm, inch, or a number of mm. [default: m]",
        metavar="UNIT",
        parse=_unit_of_rig,
    )
    rig_hand: Literal["right", "left"] | None = rig_option(
        "Which hand the rig is. [default: as its names say, else right]"
    )
    betas: tuple[float, ...] | None = rig_option(
        "Shape of a MANO hand, up to 10 numbers.",
        metavar="B,B,...",
        parse=parse.some,
    )

    def read_rig(self) -> cl.rigs.Rig:
        assert self.rig is not None
        unit = self.rig_unit / 1e3 if isinstance(self.rig_unit, float) else self.rig_unit
        return cl.rigs.read_rig(
            self.rig, mapping=self.mapping, unit=unit, handedness=self.rig_hand, betas=self.betas
        )


@dataclass(frozen=True, kw_only=True)
class HandOptions(ShapeOptions, RigOptions, SearchOptions):
    """What is known of the hand that is fitted to one image or to frames."""

    hand: Literal["right", "left", "either"] | None = own_option(
        "Which hand it is. [default: right; that of an earlier fit, or of the rig]"
    )
    fit_shape: bool = own_option("Fit size and proportions of the hand, too.", False)
    angle_std_deg: float = option(
        "Standard deviation of flexion from the starting pose.",
        12.0,
        needs="--fit-hand",
        check=checks.positive,
    )
    seed: int = option("Of all that is drawn.", 0, needs="--fit-hand")

    def settings(self, starts: StartNames) -> dict[str, Any]:
        """The arguments that `calibration.fit_hand` and `calibration.fit_hands` have both."""
        names = ("fit_shape", "angle_std_deg", "search_deg", "seed")
        settings = {"pose": starts.read(self.hand), **{n: getattr(self, n) for n in names}}
        if self.rig is None:
            return {**settings, "handedness": self.hand or "right", "shape": self.shape}
        rig = self.read_rig()
        return {**settings, "rig": rig, "handedness": rig.handedness}


def start_files(text: str) -> list[Path]:
    return StartNames(text).files


class StartNames:
    """Starts of a fit, of poses and files with commas between them."""

    def __init__(self, text: str) -> None:
        from calibration.hand_fit.starts import start_file

        # A comma in the name of a file that exists separates nothing.
        self._texts = [text] if Path(text).exists() else text.split(",")
        self.files = [path for one in self._texts if (path := start_file(one)) is not None]
        # Those in files count by their content.
        self.names = [None if start_file(one) else one for one in self._texts]

    def read(self, hand: str | None) -> tuple[Any, ...]:
        """The starts; an earlier fit has to be of the hand that was given, if it was."""
        from calibration.hand_fit.starts import starts_of

        starts = starts_of(self._texts)
        for start in starts:
            if hand is not None and start.handedness not in (None, hand):
                text = f"expected {start.handedness}, as in --pose, got '{hand}'"
                raise wrong_usage("--hand", text)
        return starts

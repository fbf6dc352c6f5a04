"""What is done with a capture before it is imaged: ``clean``, ``channels``, ``diagnose``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import calibration
import clradar as cl
import measurement_io
from clradar.cli import console, images as img, options as opt, outputs as out, parse
from clradar.errors import ModelError
from clradar.files.failures import fail
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from calibration.channels.targets import Target


def clean_command(
    *,
    capture: Path = opt.CAPTURE,
    output: Path = opt.output_option("Capture to write (HDF5)."),
    cleaning: opt.CleaningOptions,
    average: bool = opt.option(
        "Take the coherent mean of all frames of each radar folder.", False, without="--frame"
    ),
    align_phase: bool = opt.option(
        "First rotate frames to a common phase.", False, needs="--average"
    ),
    frames: opt.FrameOptions,
) -> None:
    """In this order: average the frames, subtract EMPTY, gate, correct. --frame and --variant are
    those of CAPTURE; of an EMPTY folder the first frame is taken, as recorded, or the mean of all.
    Half path lengths are (|p - tx| + |p - rx|) / 2: at least a point's z. Pairs with a dead or
    noisy channel are set to zero. Every frame of a recording: `clradar process`.
    """
    room = cleaning.empty
    if not (room or cleaning.gate_mm or cleaning.channels or average):
        expected = "--empty, --gate-mm, --channels or --average: nothing to do"
        raise opt.wrong_usage("--empty", f"expected {expected}")
    if average and not any(path.is_dir() for path in (capture, room) if path is not None):
        raise opt.wrong_usage("--average", "expected a radar folder among CAPTURE and EMPTY")
    loaded, averaged = read(capture, frames, average, align_phase)
    empty, steps = None, [averaged] if averaged else []
    if room is not None:
        empty, averaged = read(room, opt.FrameOptions(), average, align_phase)
        steps.append(f"minus {room} (scaling {cleaning.scaling}{averaged and ', ' + averaged})")
    done = cleaning.cleaned(loaded, empty)
    if cleaning.gate_mm is not None:
        gate = done.meta["range_gate"]
        steps.append(
            f"gated to {1e3 * gate['near_m']:g} to {1e3 * gate['far_m']:g} mm (inside "
            f"{gate['passband_db']:+.1f} dB at worst, rejects {gate['rejection_db']:.0f} dB or "
            f"more beyond {1e3 * gate['edge_m']:.0f} mm from it)"
        )
    if cleaning.channels is not None:
        channels = done.meta["channels"]
        steps.append(
            f"{100 * channels['live_share']:.1f} % of the pairs left, without "
            f"{len(channels['masked_tx'])} Tx and {len(channels['masked_rx'])} Rx"
        )
    out.write(output, done, "; ".join(steps))
    before_db, after_db = img.rms_db(loaded), img.rms_db(done)
    change = "zero"
    if before_db is not None and after_db is not None:
        change = f"{after_db - before_db:+.1f} dB"
    console.line(f"{output}: power against {capture}: {change}")


def read(
    path: Path, frames: opt.FrameOptions, average: bool, align_phase: bool
) -> tuple[cl.Capture, str]:
    """One frame or the mean of all, and of how many it is the mean."""
    if not (average and path.is_dir()):
        return opt.open_frame(path, frames), ""
    variant = frames.variant or "raw"
    recording = measurement_io.open_recording(path, variant=variant)
    if not len(recording):
        fail(path, f"frames of variant {variant}", "none")
    captures = (opt.noted(path, capture) for capture in console.track(recording, "averaging"))
    found = calibration.average_frames(captures, align_phase=align_phase)
    expected, count = found.meta.get("number_of_measurements"), len(recording)
    if isinstance(expected, int) and expected != count:
        console.warning(f"{path}: {count} of {expected} frames are there; averaged those")
    return found, f"mean of {console.counted(found.meta['average']['frames'], 'frame')}"


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """The known target; each option belongs to some kinds of target only."""

    target: Literal["plate", "sphere", "corner"] = opt.option("Kind of the target.")
    distance_mm: float | None = opt.option(
        "Plate: distance along z.", needs="--target=plate", due="--target=plate"
    )
    tilt_deg: tuple[float, ...] | None = opt.option(
        "Plate: farther away towards +x, +y.",
        metavar="X,Y",
        needs="--target=plate",
        parse=parse.pair,
    )
    size_mm: tuple[float, ...] | None = opt.option(
        "Plate: width and height. [default: endless]",
        metavar="W,H",
        needs="--target=plate",
        parse=parse.pair,
    )
    position_mm: tuple[float, ...] | None = opt.option(
        "Sphere: its centre; corner: its apex.",
        metavar="X,Y,Z",
        needs="--target=sphere|corner",
        due="--target=sphere|corner",
        parse=parse.position_mm,
    )
    radius_mm: float | None = opt.option(
        "Sphere: to a thousandth of it.", needs="--target=sphere", due="--target=sphere"
    )

    def read(self) -> Target:
        known = opt.arguments_of(self)
        kinds: dict[Any, Any] = {
            "plate": calibration.FlatPlate, "sphere": calibration.Sphere,
            "corner": calibration.CornerReflector,
        }  # fmt: skip
        if tilt_deg := known.pop("tilt_deg", None):
            known |= dict(zip(("tilt_x_deg", "tilt_y_deg"), tilt_deg, strict=True))
        return kinds[known.pop("target")](**known)


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    PANEL = "Expert"

    tolerance_mm: float = opt.option("Tolerance of its position, per axis.", 10.0)
    tilt_tolerance_deg: float = opt.option("How well a plate's tilt is known.", 2.0)
    max_delay_ps: float = opt.option("Largest delay of a pair that is searched for.", 100.0)
    common_delay: Literal["zero", "free"] = opt.option("Delays scatter about this.", "zero")

    def settings(self) -> dict[str, Any]:
        """Settings of `calibration.estimate_channels`."""
        found = opt.arguments_of(self)
        found["position_tolerance_m"] = found.pop("tolerance_m")
        return found


def channels_command(
    *,
    capture: Path = opt.argument(
        "Of the target: native capture, recorded .npy frame, or radar folder.",
    ),
    target: TargetOptions,
    output: Path = opt.output_option("Channels to write (HDF5)."),
    estimate: EstimateOptions,
    plot: Path | None = opt.figure("Also draw gains, phases and delays", "--plot"),
    frames: opt.FrameOptions,
) -> None:
    """The target's position is refined, too. Which errors are observable:
    docs/channel-calibration.md. The mean of a recording's frames: `clradar clean --average`.
    """
    from calibration.channels.figure import channels_figure
    from measurement_io.record_facts import Description, facts_of

    known = target.read()
    loaded = opt.open_frame(capture, frames)
    with console.bar("fitting channels") as progress:
        channels = calibration.estimate_channels(
            loaded, known, progress=progress, **estimate.settings()
        )
    channels = out.write(output, channels)
    facts = facts_of(channels)
    first = [fact.name for fact in facts].index("dead Tx")  # what is before is of the capture, too
    console.text(str(Description(str(output), "channels", tuple(facts[first:-1]))))
    figure = partial(channels_figure, channels, img.title_of(capture, loaded.meta))
    out.write(plot, figure, "gains, phases and delays")


SCORE_COLUMNS = ("axes", "phase", "frequencies", "sharpness (dB)", "brightest at x, y, z (mm)", "")
COARSE_GRID_MM = ((-100.0, 100.0, 4.0), (-100.0, 100.0, 4.0), (260.0, 340.0, 10.0))


def diagnose_command(
    *,
    capture: Path = opt.CAPTURE,
    output: Path | None = opt.figure("Figure of all images", "-o", "--output"),
    json: Path | None = opt.written("File for the result, in metres."),
    fix_to: Path | None = opt.written("The capture in clradar's convention (HDF5)."),
    expect_mm: tuple[float, ...] | None = opt.option(
        "Rough position (20 mm) of a known target: decides between equally sharp images.",
        metavar="X,Y,Z",
        parse=parse.position_mm,
    ),
    voxels: opt.GridOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Compares how sharp coarse images are under eight hypotheses. The range profile shows where to
    image; with a range, the grid is that of the options, by default -100:100:4, -100:100:4,
    260:340:10. See docs/diagnose.md.
    """
    grid = voxels.grid(COARSE_GRID_MM) if opt.given(voxels) else None
    expected_m = None if expect_mm is None else opt.scaled(expect_mm, 1e3)
    loaded = opt.open_frame(capture, frames)
    opened = open_devices(device).first
    with console.bar("imaging") as progress:
        result = calibration.diagnose(
            loaded, grid=grid, expected_m=expected_m, device=opened, progress=progress
        )
    if result.scores:
        panels: dict[bool, list[Any]] = {}  # a row for each order of axes
        for score in result.scores:
            h, level = score.hypothesis, decibels(score.relative_db)
            label = f"{'BEST: ' * (mark_of(result, h) == 'best')}{h.label}\n{level} dB"
            panels.setdefault(h.swapped, []).append((label, score.image))
        rows = []
        for score in sorted(result.scores, key=lambda s: -s.relative_db):
            h, place = score.hypothesis, ", ".join(f"{1e3 * v:.0f}" for v in score.peak_m)
            row = [
                "[rx, tx]" if h.swapped else "[tx, rx]",
                "exp(+j)" if h.conjugated else "exp(-j)",
            ]
            row += ["descending" if h.reversed else "ascending", decibels(score.relative_db), place]
            rows.append([*row, mark_of(result, h)])
        console.table(SCORE_COLUMNS, rows, right=SCORE_COLUMNS[3:5])
    console.line(result.recommendation)
    out.write(json, {"capture": str(capture), **result.to_dict()}, "the result, in metres")
    if result.scores:
        title = img.title_of(capture, loaded.meta)
        figure = partial(cl.plot.panels_figure, list(panels.values()), title)
        out.write(output, figure, "the image under each hypothesis")
    elif output is not None:
        console.warning(f"{output}: not drawn, since there is no image")
    if fix_to is not None:
        if result.best is None:
            raise ModelError(f"{capture}: not written, since its convention is not known")
        others = [f"'{h.label}'" for h in result.candidates[1:]]
        others += [] if result.mirror_known else ["the mirror image"]
        if others:
            console.warning(f"{capture}: {' / '.join(others)} cannot be ruled out")
        fixed = calibration.apply_convention(loaded, result.best)
        undone = f"with '{result.best.label}' undone" if result.best.changes else "as it is"
        out.write(fix_to, fixed, f"the capture {undone}")


def mark_of(result: calibration.Diagnosis, hypothesis: calibration.Hypothesis) -> str:
    """Whether a hypothesis is the best, or one of those that remain."""
    left = [replace(candidate, mirrored=False) for candidate in result.candidates]
    if hypothesis not in left:
        return ""
    return "best" if result.best and hypothesis == left[0] else "ambiguous"


def decibels(relative_db: float) -> str:
    """A level for a table, without -0.0."""
    return f"{round(relative_db, 1) + 0.0:.1f}" if relative_db > -100 else "< -100"

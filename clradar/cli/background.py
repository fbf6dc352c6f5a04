"""``clradar background``."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Optional

import numpy as np
import typer

from clradar.cli.frames import load_frame, load_mean
from clradar.cli.options import ForceOption, FrameOption, VariantOption, wrong_usage
from clradar.cli.output import check_outputs, print_line, print_warning
from clradar.cli.simulate import save_with_provenance

GATE_RULE = "NEAR:FAR, half path lengths"


class Scaling(str, Enum):
    """What the empty capture is multiplied by."""

    none = "none"
    common = "common"
    channel = "channel"


def command(
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE", help="Native capture, recorded .npy frame, or radar folder."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture to write (HDF5).")],
    empty: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--empty", metavar="EMPTY", help="The same without the object: subtracted."),
    ] = None,
    scaling: Annotated[
        Scaling,
        typer.Option(
            "--scaling",
            help="Multiply EMPTY by complex factors first, for drift: one for all, or one per "
            "channel.",
        ),
    ] = Scaling.none,
    gate_mm: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--gate-mm", metavar="NEAR:FAR", help=f"Keep only echoes from this window: {GATE_RULE}."
        ),
    ] = None,
    edge_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--edge-mm",
            metavar="MM",
            help="Width of the window's edges, outside it. [default: 4 c / 2B, 60 for 10 GHz]",
        ),
    ] = None,
    clutter_db: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--clutter-db",
            metavar="DB",
            help="How much stronger echoes outside the window are than inside. [default: 40]",
        ),
    ] = None,
    average: Annotated[
        bool,
        typer.Option(
            "--average", help="Take the coherent mean of all frames of each radar folder."
        ),
    ] = False,
    align_phase: Annotated[
        bool,
        typer.Option("--align-phase", help="With --average: first turn frames to a common phase."),
    ] = False,
    frame: FrameOption = None,
    variant: VariantOption = None,
    force: ForceOption = False,
) -> None:
    """In this order: average the frames, subtract EMPTY, gate. At least one has to be asked for.

    --frame and --variant are those of CAPTURE. Of an EMPTY folder the first frame is taken, as
    recorded, or the mean of all. Half path lengths are (|p - tx| + |p - rx|) / 2: at least a
    point's z, and at most its distance from the farthest antenna.
    """
    from calibration import range_gate, subtract_background

    window = None if gate_mm is None else gate_ends(gate_mm)
    sources = [path for path in (capture, empty) if path is not None]
    if empty is None and window is None and not average:
        raise wrong_usage("--empty", "expected --empty, --gate-mm or --average: nothing to do")
    if empty is None and scaling is not Scaling.none:
        raise wrong_usage("--scaling", "expected --empty with it")
    if window is None and (edge_mm is not None or clutter_db is not None):
        raise wrong_usage("--edge-mm, --clutter-db", "expected --gate-mm with it")
    if align_phase and not average:
        raise wrong_usage("--align-phase", "expected --average with it")
    if average and frame is not None:
        raise wrong_usage("--frame", "expected either --frame or --average")
    if average and not any(path.is_dir() for path in sources):
        raise wrong_usage("--average", "expected a radar folder among CAPTURE and EMPTY")
    check_outputs([output], force=force, inputs=sources)

    chosen = None if variant is None else variant.value
    inputs: list[Path]
    steps = []
    if average and capture.is_dir():
        done, inputs = load_mean(capture, variant=chosen, align_phase=align_phase)
        steps.append(mean_text(done))
    else:
        done, inputs = load_frame(capture, frame=frame, variant=chosen)
    before = rms(done)
    if empty is not None:
        if done.meta.get("variant") == "emptyfiltered":
            print_warning(f"{capture}: emptyfiltered, so an empty room is subtracted already")
        if average and empty.is_dir():
            without, files = load_mean(empty, align_phase=align_phase)
            words = f", {mean_text(without)}"
        else:
            without, files = load_frame(empty)
            words = ""
        inputs = [*inputs, *files]
        done = subtract_background(done, without, scaling=scaling.value)
        steps.append(f"minus {empty} (scaling {scaling.value}{words})")
    if window is not None:
        settings: dict[str, Any] = {"near_m": window[0], "far_m": window[1]}
        if edge_mm is not None:
            settings["edge_m"] = edge_mm / 1e3
        if clutter_db is not None:
            settings["clutter_db"] = clutter_db
        done = range_gate(done, **settings)
        steps.append(gate_text(done.meta["range_gate"]))

    options = {
        "capture": str(capture),
        "empty": None if empty is None else str(empty),
        "scaling": scaling.value,
        "gate_mm": gate_mm,
        "edge_mm": edge_mm,
        "clutter_db": clutter_db,
        "average": average,
        "align_phase": align_phase,
        "frame": frame,
        "variant": chosen,
    }
    save_with_provenance(output, done, "background", options, inputs, force=force)
    print_line(f"{output}: {'; '.join(steps)}")
    after = rms(done)
    change = f"{20 * np.log10(after / before):+.1f} dB" if before > 0 and after > 0 else "zero"
    print_line(f"{output}: power against {capture}: {change}")


def gate_ends(text: str) -> tuple[float, float]:
    """Return both ends of ``NEAR:FAR`` in metres."""
    try:
        near, far = (float(part) / 1e3 for part in text.split(":"))
    except ValueError:
        near = far = np.nan
    if not (np.isfinite(near) and np.isfinite(far) and 0 <= near < far):
        raise wrong_usage(
            "--gate-mm", f"expected {GATE_RULE} in millimetres, 0 <= NEAR < FAR; got '{text}'"
        )
    return near, far


def mean_text(capture: Any) -> str:
    """Return what was averaged, in words."""
    count = capture.meta["average"]["frames"]
    return "1 frame" if count == 1 else f"mean of {count} frames"


def gate_text(record: dict[str, float]) -> str:
    """Return what a gate does, in words."""
    return (
        f"gated to {1e3 * record['near_m']:g} to {1e3 * record['far_m']:g} mm (inside "
        f"{record['passband_db']:+.1f} dB at worst, rejects {record['rejection_db']:.0f} dB or "
        f"more beyond {1e3 * record['edge_m']:.0f} mm from it)"
    )


def rms(capture: Any) -> float:
    """Return the RMS amplitude of a capture's samples."""
    return float(np.sqrt(np.mean(np.abs(capture.data) ** 2, dtype=np.float64)))

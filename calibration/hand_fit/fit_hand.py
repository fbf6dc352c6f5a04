"""Fit of a posed hand to a measured image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from calibration.hand_fit.result import HandFit
from clradar.hand import HandPose, HandShape
from clradar.hand.shape import AVERAGE
from clradar.model import AntennaArray, Capture, DepthMap, Volume, Waveform
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.rigs import Rig


def fit_hand(
    measured: Capture | Volume | DepthMap,
    pose: str | Path | HandPose | HandFit | Sequence[str | Path | HandPose | HandFit] = "all",
    *,
    rig: Rig | None = None,
    handedness: str = "right",
    shape: HandShape = AVERAGE,
    fit_shape: bool = False,
    alpha: float | None = None,
    closed_loop: bool = True,
    angle_std_deg: float = 12.0,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    search_deg: float = 45.0,
    seed: int = 0,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> HandFit:
    """Fit joint angles, shape, place, brightness and alpha of a hand to its measurement."""
    raise NotImplementedError

"""Calibration of recordings, and registration of simulations to them."""

# Functions take the names of their modules: `from calibration import align` gives the function.
from calibration.channels.correction import correct
from calibration.channels.estimate import estimate_channels
from calibration.channels.targets import CornerReflector, FlatPlate, Sphere, response
from calibration.cleaning import clean
from calibration.clutter import average_frames, range_gate, subtract_background
from calibration.conventions import (
    HYPOTHESES,
    Diagnosis,
    Hypothesis,
    Score,
    apply_convention,
    diagnose,
)
from calibration.hand_fit.fit_hand import fit_hand
from calibration.hand_fit.fit_hands import fit_hands
from calibration.hand_fit.frame_fit import FrameFit
from calibration.hand_fit.result import Basin, HandFit
from calibration.registration.align_images import align
from calibration.registration.align_mesh import align_mesh
from calibration.registration.alignment import Alignment
from calibration.registration.beyond_noise import Place
from calibration.registration.closed_loop import Registration, Round
from calibration.registration.register import register
from calibration.roughness.alpha import AlphaEstimate
from calibration.roughness.millimetres import RoughnessEstimate
from calibration.roughness.regions import Regions
from calibration.roughness.roughness_sweep import RoughnessSweep, sweep_roughness
from calibration.roughness.sweep import Sweep, sweep

__all__ = [
    "HYPOTHESES",
    "Alignment",
    "AlphaEstimate",
    "Basin",
    "CornerReflector",
    "Diagnosis",
    "FlatPlate",
    "FrameFit",
    "HandFit",
    "Hypothesis",
    "Place",
    "Regions",
    "Registration",
    "RoughnessEstimate",
    "RoughnessSweep",
    "Round",
    "Score",
    "Sphere",
    "Sweep",
    "align",
    "align_mesh",
    "apply_convention",
    "average_frames",
    "clean",
    "correct",
    "diagnose",
    "estimate_channels",
    "fit_hand",
    "fit_hands",
    "range_gate",
    "register",
    "response",
    "subtract_background",
    "sweep",
    "sweep_roughness",
]


def __dir__() -> list[str]:
    return sorted(__all__)

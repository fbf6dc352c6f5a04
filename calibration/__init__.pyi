from .channels.correction import correct as correct
from .channels.estimate import estimate_channels as estimate_channels
from .channels.targets import (
    CornerReflector as CornerReflector,
    FlatPlate as FlatPlate,
    Sphere as Sphere,
    response as response,
)
from .clutter import (
    average_frames as average_frames,
    clean as clean,
    range_gate as range_gate,
    subtract_background as subtract_background,
)
from .conventions import (
    HYPOTHESES as HYPOTHESES,
    Diagnosis as Diagnosis,
    Hypothesis as Hypothesis,
    Score as Score,
    apply_convention as apply_convention,
    diagnose as diagnose,
)
from .hand_fit.fit_hand import fit_hand as fit_hand
from .hand_fit.fit_hands import fit_hands as fit_hands
from .hand_fit.frame_fit import FrameFit as FrameFit
from .hand_fit.result import Basin as Basin, HandFit as HandFit
from .registration.align_images import align as align
from .registration.align_mesh import align_mesh as align_mesh
from .registration.alignment import Alignment as Alignment
from .registration.beyond_noise import Place as Place
from .registration.closed_loop import Registration as Registration, Round as Round
from .registration.register import register as register
from .roughness.estimates import (
    AlphaEstimate as AlphaEstimate,
    RoughnessEstimate as RoughnessEstimate,
)
from .roughness.regions import Regions as Regions
from .roughness.roughness_sweep import (
    RoughnessSweep as RoughnessSweep,
    sweep_roughness as sweep_roughness,
)
from .roughness.sweep import Sweep as Sweep, sweep as sweep

"""From the capture of a hand, and no mesh, to its joints: fit, compare with the truth, draw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from clradar.calibration.hand_fit.figure import hand_fit_figure

import clradar
from clradar.calibration import fit_hand
from clradar.hand import JointAngles, hand_mesh, pose_by_name
from clradar.plot import save_figure

DIGITS = ("thumb", "index", "middle", "ring", "pinky")


def main(closed_loop: bool = True, spacing_m: float = 2e-3) -> None:
    # The letter L as somebody makes it who does not stretch the index finger.
    letter = pose_by_name("L")
    bent = {"index-finger-phalanx-proximal": JointAngles.from_degrees(25.0, 4.0)}
    shown = replace(letter, joints={**letter.joints, **bent})
    hand = hand_mesh(shown, edge_length_m=2.4e-3, center_m=(0.005, -0.008, 0.3))
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 64)
    scene = clradar.Scene.from_mesh(hand, alpha=0.4)
    clean = clradar.simulate(scene, array, waveform, samples_per_mm2=1, seed=1)
    capture = clradar.impair(clean, snr_db=20, seed=1)

    # Of a recording: clradar.measurement_io.open_capture("hand/30", frame=0) instead of all above.
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.11, 0.11), (0.25, 0.34), spacing_m)
    measured = clradar.backproject(capture, grid)
    radar = {"array": capture.array, "waveform": capture.waveform}
    found = fit_hand(measured, "L", closed_loop=closed_loop, **radar)
    print(found.report())
    tips_m = hand.joints_m[[4, 9, 14, 19, 24]]
    for digit, off_m, std_m in zip(
        DIGITS, np.linalg.norm(found.tips_m - tips_m, axis=1), found.tip_std_m, strict=True
    ):
        print(f"{digit}: {1e3 * off_m:.1f} mm from the truth, {1e3 * std_m:.1f} mm stated")
    save_figure(hand_fit_figure(measured, found), "fitted-hand.png", force=True)


if __name__ == "__main__":
    main()

"""Write a small example of every format that is written: python frozen_files.py FOLDER [KIND...].

`tests/files/frozen/` holds what it wrote at different times; `tests/files/test_frozen.py` reads all
of it. Arrays are made of whole numbers, so that tests can say what a file has to hold.
"""

import shutil
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import faulty_samples
import numpy as np
from dataset_plans import plan_of
from hand_fits import made_up_fit

import calibration
import clradar
import clradar.dataset
from calibration.hand_fit.frame_fit import FrameFit
from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.result import ANGLE_NAMES
from clradar.cli import main
from clradar.files.json_file import write_json
from clradar.hand import POSES, write_pose
from clradar.model import ImageScale
from measurement_io import save_capture, save_channels, save_recording, save_volume

META = {"seed": 7, "note": "frozen", "list": [1, 2.5, None, True]}


def counted(*shape: int) -> np.ndarray:
    """1 + 0j, 2 - 1j, 3 - 2j ..., complex64."""
    n = np.arange(np.prod(shape)).reshape(shape)
    return (n + 1 - 1j * n).astype(np.complex64)


def capture(*, patterns: bool = False) -> clradar.Capture:
    """3 Tx, 2 Rx, 5 frequencies; with two antenna patterns, one of them a table."""
    n = np.arange(15).reshape(5, 3) / 100
    array = clradar.AntennaArray(n[:3], n[3:], "frozen")
    if patterns:
        table = clradar.AntennaPattern(2.0, angle_deg=[0.0, 30.0, 180.0], field=[1.0, 0.5, 0.0])
        lobe = clradar.AntennaPattern(3.5, 1.5)
        array = replace(array, tx_pattern=lobe, rx_pattern=table)
    waveform = clradar.Waveform([76e9, 77e9, 78e9, 79e9, 81e9])
    return clradar.Capture(counted(3, 2, 5), array, waveform, META)


def volume(*, scale: bool = False) -> clradar.Volume:
    """4 x 3 x 5 voxels along x, y, z; the amplitude grows with the index."""
    grid = clradar.VoxelGrid([-0.02, -0.01, 0.3], [1e-2, 2e-2, 5e-3], (4, 3, 5))
    of = capture(patterns=True)
    window = ImageScale(of.array, of.waveform, np.array([0.5, 1.0, 1.5, 1.0, 1.0]))
    return clradar.Volume(counted(*grid.shape), grid, META, window if scale else None)


def channels(*, patterns: bool = False) -> clradar.ChannelCalibration:
    """Calibrated channels of the capture, Tx 1 dead, Rx 1 noisy."""
    of = capture(patterns=patterns)
    return clradar.ChannelCalibration(
        response=clradar.ChannelResponse(
            [1, 0, 2j], [0.5, 1], [0, 0, 1e-12], [2e-12, 0], of.waveform.frequencies_hz[1]
        ),
        array=of.array, waveform=of.waveform, target="corner",
        target_position={"x_m": 0.0, "y_m": 0.125, "z_m": 0.25},
        target_covariance=np.diag([1.0, 2.0, 3.0]), target_amplitude=1.5,
        dead_tx=[1], dead_rx=[], noisy_tx=[], noisy_rx=[1],
        tx_noise=[0, 1, 2], rx_noise=[0, 3], tx_phase_std_rad=[0.25, 0.5, 0.75],
        rx_phase_std_rad=[0.125, 0.25], tx_delay_std_s=[0, 1e-12, 2e-12], rx_delay_std_s=[0, 1e-12],
        residual_db=-20.0, noise_residual_db=-21.0, meta=META,
    )  # fmt: skip


def write_native(folder: Path) -> None:
    save_capture(folder / "capture-1.h5", capture())
    save_capture(folder / "capture-2.h5", capture(patterns=True))
    save_volume(folder / "volume-1.h5", volume())
    save_volume(folder / "volume-2.h5", volume(scale=True))
    save_channels(folder / "channels-1.h5", channels())
    save_channels(folder / "channels-2.h5", channels(patterns=True))


def write_recording(folder: Path) -> None:
    """One frame of two frequencies in both variants, most of it zero."""
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 2)
    data = np.zeros((94, 94, 2), np.complex64)
    data[0, 0], data[3, 5], data[93, 93] = counted(3, 2)
    raw = clradar.Capture(data, array, waveform, {"timestamp_us": 1000, "gain": 0.5})
    turn = np.diag([-1.0, 1, 1, 1])
    beside = {
        "metadata": {"distance_meters": 0.3, "labels": ["frozen"]},
        "alignment": {"photogrammetry2radar": turn.tolist()},
    }
    radar = save_recording(folder / "recording" / "30", [raw], **beside)
    (frame,) = save_recording(folder / "filtered", [replace(raw, data=data / 2)]).rglob("*.npy")
    frame.rename(radar / "calibrated_data/000000_emptyfiltered.npy")
    shutil.rmtree(folder / "filtered")


def write_data_sets(folder: Path) -> None:
    """A complete one of every product, and one that was stopped, with a shard that lacks one."""
    small = {"radar": {"every": 24, "steps": 4}, "image": {"step_mm": [25, 25, 50]}}
    whole = plan_of(samples=2, poses={"names": ["A", "F"]}, output={"shard_size": 1}, **small)
    clradar.dataset.run(whole, folder / "data-set", device="pocl")
    products = ["max_projection", "depth_map", "joints"]
    stopped = plan_of(samples=5, output={"products": products}, **small)
    with faulty_samples.faults({1: "raise", 2: "stop"}), suppress(KeyboardInterrupt):
        clradar.dataset.run(stopped, folder / "data-set-stopped", device="pocl")


def write_hands(folder: Path) -> None:
    """Poses, materials, fits of hands, a truth and joints."""
    for suffix in ("toml", "json"):
        write_pose(folder / f"pose.{suffix}", POSES["W"])
        palm = clradar.material("palm")
        clradar.write_materials(folder / f"materials.{suffix}", [palm, clradar.material("metal")])
    fit = made_up_fit()
    write_json(folder / "fit.json", {**fit.to_dict(), "clradar": clradar.__version__}, force=False)
    n, n_angles, n_shape = 25, len(ANGLE_NAMES), len(SHAPE_NAMES)
    seen = FrameFit(
        3, 0.5, "followed", "F", ("a note",), "right",
        HandState(fit.pose, fit.shape, fit.transform), fit.joints_m, np.full(n, 2e-3),
        np.radians(np.full(n_angles, 3.0)), np.full(n_shape, 0.25), fit.untold, 12.5, 0.75,
    )  # fmt: skip
    write_json(folder / "frame-fit.json", seen.to_dict(), force=False)
    nothing = FrameFit.nothing(4, 0.625, ("dark",), "right")
    write_json(folder / "frame-nothing.json", nothing.to_dict(), force=False)
    run("hand", "F", "-o", folder / "hand.ply", "--joints", folder / "joints.json")
    (folder / "hand.ply").unlink()


def run(*arguments: object) -> None:
    """Run a command, which has to succeed."""
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as ended:
        if ended.code:
            raise


def write_alignment(folder: Path) -> None:
    quarter = np.eye(4)
    quarter[:3] = [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.01]]
    found = calibration.Alignment(
        quarter, rms_m=1e-3, inlier_share=0.9, iterations=5, converged=True,
        covariance=1e-6 * np.eye(6), degenerate_directions=(), centre_m=np.array([0, 0, 0.3]),
    )  # fmt: skip
    write_json(folder / "transform.json", found.to_dict(), force=False)


KINDS = {
    "native": write_native,
    "recording": write_recording,
    "data-sets": write_data_sets,
    "hands": write_hands,
    "alignment": write_alignment,
}


if __name__ == "__main__":
    made = Path(sys.argv[1])
    made.mkdir(parents=True)
    for kind in sys.argv[2:] or KINDS:
        KINDS[kind](made)

"""A hand that is registered once for all tests of alignments to meshes."""

import pytest
from hand_registrations import ARRAY, RADAR, RAYS, WAVEFORM, Registered, truth

import clradar
from calibration import register
from clradar.hand import hand_mesh


@pytest.fixture(scope="session")
def hand() -> clradar.Scene:
    mesh = hand_mesh("flat", 3e-3)
    return clradar.Scene(mesh.vertices_m, mesh.faces, 0.3, mesh.part, mesh.part_names, mesh.normals)


@pytest.fixture(scope="session")
def measured(hand) -> clradar.Volume:
    """The hand at `truth`, with noise of 20 dB."""
    capture = clradar.simulate(
        hand.transformed(truth()), ARRAY, WAVEFORM, seed=50, device="pocl", **RAYS
    )
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 2.5e-3)
    return clradar.backproject(clradar.impair(capture, snr_db=20.0, seed=4), grid, device="pocl")


@pytest.fixture(scope="session")
def registered(measured, hand) -> Registered:
    rounds, shares = [], []
    result = register(
        measured, hand, search_deg=10.0, max_rounds=8, callback=rounds.append,
        progress=lambda done, total: shares.append(done / total), **RADAR, **RAYS,
    )  # fmt: skip
    return Registered(result, rounds, shares)

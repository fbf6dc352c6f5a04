"""Antennas in bundles: complete, close together, and no answer depends on them."""

from functools import cache

import numpy as np
import pytest
from core import meshes
from shapes import bowl

import clradar
from clradar.hand import hand_mesh
from clradar.tracing.antenna_packets import BUNDLE, GROUP, bundled
from clradar.tracing.visible_surface import VisibleSurface

RNG = np.random.default_rng(30)
ARRAYS = {
    "one": np.array([[0.01, 0.02, 0.0]]),
    "nine": RNG.uniform([-0.07, -0.07, 0], [0.07, 0.07, 0], (9, 3)),
    "imager": clradar.arrays.qar50().tx_m,
    "shuffled imager": RNG.permutation(clradar.arrays.qar50().tx_m),
    "scattered": RNG.uniform([-0.1, -0.1, -0.02], [0.1, 0.1, 0.02], (201, 3)),
    "all round": 0.6 * RNG.normal(size=(67, 3)) + [0, 0, 0.3],
    "along x": RNG.uniform([-0.9, -0.1, 0.2], [-0.8, 0.1, 0.4], (30, 3)),
    "same place": np.repeat([[0.0, 0.0, 0.1]], 70, axis=0),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_every_antenna_is_in_one_slot_and_in_its_boxes(name):
    at = ARRAYS[name].astype(np.float32)
    n_groups = -(-len(at) // GROUP)
    flat = bundled(ARRAYS[name])
    columns, header, bundles = np.split(flat, [3 * n_groups * GROUP, 3 * n_groups * GROUP + 8])
    np.testing.assert_array_equal(columns.reshape(3, -1)[:, : len(at)], at.T)
    bundles = bundles.view(BUNDLE)
    assert header.view(np.int32)[0] == len(bundles)
    found = []
    for bundle in bundles:
        antenna, positions = bundle["antenna"], bundle["position"]
        assert (antenna[bundle["n_groups"] :] == -1).all()
        for g in range(bundle["n_groups"]):
            members = antenna[g][antenna[g] >= 0]
            assert len(members) > 0
            np.testing.assert_array_equal(positions[:, g, : len(members)], at[members].T)
            np.testing.assert_array_equal(bundle["low"][:, g], at[members].min(axis=0))
            np.testing.assert_array_equal(bundle["high"][:, g], at[members].max(axis=0))
            if bundle["first"][g] >= 0:
                successive = bundle["first"][g] + np.arange(len(members))
                np.testing.assert_array_equal(members, successive)
            found += members.tolist()
    assert sorted(found) == list(range(len(at)))


SCENES = {
    "hand": None,  # made where it is used, since that takes a device
    "bowl": clradar.Scene(*bowl(40, 80)),
    # Fine enough that groups and rays are traced apart from their bundle.
    "fine ball": meshes.ball(201, 200),
}


@cache
def scene_of(name: str) -> clradar.Scene:
    return SCENES[name] or clradar.Scene.from_mesh(hand_mesh("F", edge_length_m=4e-3))


@pytest.mark.parametrize("scene", SCENES)
def test_shafts_and_single_rays_agree(scene):
    """The same bits from the kernel for CPUs, by shafts, and that for GPUs, ray by ray."""
    seen = []
    for width in (1, 8):
        device = clradar.open_device("pocl", width=width)
        with VisibleSurface(scene_of(scene), 0.003, 3.0, device) as surface:
            seen.append({name: surface.visible_from(at) for name, at in ARRAYS.items()})
    for name in ARRAYS:
        np.testing.assert_array_equal(seen[0][name], seen[1][name], err_msg=name)
    both = np.concatenate(list(seen[0].values()), axis=1)
    assert 0.05 < both.mean() < 0.95  # there are enough of either to compare

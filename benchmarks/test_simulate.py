"""Simulating the embedded hand, and making its mesh; nobody else offers either."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import count
from typing import Any

import pytest
import trimesh

import clradar
from clradar import reference
from clradar.bench.timing import ARRAY, WAVEFORM, relative_rms_db
from clradar.hand import hand_mesh
from clradar.hand.mesh import DEFAULT_EDGE_LENGTH_M

Measured = Callable[[Callable[[], Any]], Any]

SAMPLES_PER_MM2 = 2.0
"""A fifth of the default experiment."""

SAME_SUM_DB = -100.0
"""The float64 sum over the same paths: phases in float32, moments of E7."""


@pytest.mark.benchmark(group="simulate a hand, 2 samples/mm^2")
def test_simulate(measured: Measured, device: clradar.Device) -> None:
    scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=0.5)
    settings = {"samples_per_mm2": SAMPLES_PER_MM2, "seed": 1, "device": device}
    capture: clradar.Capture = measured(
        partial(clradar.simulate, scene, ARRAY, WAVEFORM, **settings)
    )
    paths = clradar.trace(scene, ARRAY, **settings)
    some = clradar.Waveform(WAVEFORM.frequencies_hz[::31])
    want = reference.synthesize(paths, ARRAY, some)
    assert relative_rms_db(capture.data[:, :, ::31], want) <= SAME_SUM_DB


@pytest.mark.benchmark(group="hand mesh")
def test_hand_mesh(measured: Measured) -> None:
    factor = count(1)  # a new length each time, since the last few meshes are cached
    mesh = measured(lambda: hand_mesh("F", DEFAULT_EDGE_LENGTH_M * (1 + 1e-6 * next(factor))))
    solid = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    assert solid.is_watertight
    assert 1e-4 < solid.volume < 6e-4  # a hand has about 0.35 litres

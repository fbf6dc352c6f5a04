"""What the live view shows beside a measurement: other files, and simulations of a mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clradar
from clradar.view import beside
from clradar.view.beside import MATERIALS, Others, Simulation
from clradar.view.session import Session, Shown, View
from clradar.view.sources import FixedFrames
from clradar.view.wish import BY_ALPHA, Wish

GRID = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (3, 2, 2))
ARRAY = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]])
CAPTURE = clradar.Capture(np.ones((2, 1, 3)), ARRAY, clradar.Waveform([76e9, 77e9, 78e9]))
MESH = clradar.Scene([[0, 0, 0.3], [0.01, 0, 0.3], [0, 0.01, 0.3]], [[0, 1, 2]])


def volume(amplitude: float) -> clradar.Volume:
    return clradar.Volume(np.full(GRID.shape, amplitude), GRID)


def frames(name: str, *contents: Any) -> FixedFrames:
    return FixedFrames(
        name, tuple(f"{name} {i}" for i in range(len(contents))), contents.__getitem__
    )


class Front:
    """A front that keeps what it is told."""

    def __init__(self) -> None:
        self.shown: list[Shown] = []
        self.said: list[str] = []

    def show(self, shown: Shown) -> None:
        self.shown.append(shown)

    def busy(self, text: str) -> None:
        self.said.append(text)

    def refuse(self, text: str) -> None:
        self.said.append(text)


def image(content: Any, wish: Wish, progress: Any) -> clradar.Volume:
    return clradar.Volume(np.full(GRID.shape, content.data[0, 0, 0]), GRID)


def test_a_recording_of_as_many_frames_goes_along() -> None:
    measured = frames("measured", *map(volume, (1, 2, 3)))
    others = Others(measured, (frames("along", *map(volume, (4, 5, 6))), frames("one", volume(7))))
    assert others.labels == ("along", "one")
    front = Front()
    session = Session(View(source=measured, wish=Wish(), beside=others), front)
    try:
        for changes in ({"frame": 2}, {"frame": 1}, {"other": 1}):
            session.change(**changes)
            session.settle()
    finally:
        session.close()
    pairs = [
        tuple(float(one.image.amplitude.max()) for one in (shown.first, shown.second))
        for shown in front.shown
        if shown.second is not None
    ]
    assert pairs == [(3, 6), (2, 5), (2, 7)]


def test_a_mesh_is_simulated_once_for_each_alpha_and_material(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[Any, ...]] = []

    def simulate(scene: clradar.Scene, *_: Any, estimator: Any, **more: Any) -> clradar.Capture:
        if float(scene.alpha[0]) == 0.9:
            raise clradar.errors.DeviceError("out of memory")
        asked.append((float(scene.alpha[0]), scene.materials[0].name, estimator))
        return CAPTURE

    monkeypatch.setattr(beside, "simulate", simulate)
    front = Front()
    source = frames("measured", CAPTURE, CAPTURE)
    session = Session(
        View(source=source, wish=Wish(grid=GRID), beside=Simulation(MESH)), front, form=image
    )
    wishes: list[dict[str, Any]] = [
        {}, {"frame": 1}, {"alpha": 0.2}, {"alpha": 0.5}, {"material": "palm"}, {"alpha": 0.7},
        {"material": BY_ALPHA, "alpha": 0.9},
    ]  # fmt: skip
    try:
        for changes in wishes:
            session.change(**changes)
            session.settle()
    finally:
        session.close()
    assert asked == [
        (0.5, "perfect conductor", None),
        (0.2, "perfect conductor", None),
        (0.5, "palm", "physical"),
    ]
    # The measured image is there while the first one is simulated, and when it cannot be.
    assert [shown.second is None for shown in front.shown][:2] == [True, False]
    assert front.shown[-1].second is None
    assert front.said[-1] == "out of memory"
    assert "palm" in MATERIALS


def test_arrays_of_other_gains_are_simulated_for_themselves() -> None:
    simulation, n = Simulation(MESH), CAPTURE.array.n_tx
    pattern = clradar.AntennaPattern(exponent=1.0)
    changes = (
        {},
        {"tx_gain": [0.5] * n},
        {"tx_boresight": [[0.1, 0, 1]] * n},
        {"tx_pattern": pattern},
    )
    arrays = [replace(CAPTURE.array, **change) for change in changes]
    keys = {simulation.key(Wish(), replace(CAPTURE, array=array)) for array in arrays}
    assert len(keys) == len(arrays)


def test_a_volume_does_not_say_what_radar_recorded_it() -> None:
    front = Front()
    session = Session(
        View(source=frames("volume", volume(1)), wish=Wish(), beside=Simulation(MESH)), front
    )
    try:
        session.change()
        session.settle()
    finally:
        session.close()
    assert [shown.second for shown in front.shown] == [None]

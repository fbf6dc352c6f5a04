"""Values in another unit than the interface's are refused, and the message names the unit."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clradar import AntennaArray, VoxelGrid, Waveform
from clradar.arrays import qar50
from clradar.constants import PLAUSIBLE_HZ
from clradar.errors import ModelError

GRID = VoxelGrid.from_extent
SIDE, FRONT = (-100, 100), (260, 340)


def scaled(tx: float, rx: float | None = None) -> AntennaArray:
    imager = qar50()
    return AntennaArray(tx * imager.tx_m, (tx if rx is None else rx) * imager.rx_m)


WRONG: dict[str, tuple[Callable[[], Any], str]] = {
    "GHz": (lambda: Waveform.sfcw(72, 82, 128), "72 to 82 GHz (7.2e+10 to 8.2e+10 Hz)?"),
    "one in GHz": (lambda: Waveform.sfcw(72, 82e9, 128), "got 72 Hz; did you mean 72 GHz"),
    "MHz": (lambda: Waveform.sfcw(72e3, 82e3, 128), "72000 to 82000 MHz"),
    "converted twice": (lambda: Waveform.sfcw(72e18, 82e18, 128), "7.2e+19 to 8.2e+19 Hz"),
    "denormal Hz": (lambda: Waveform.sfcw(1e-320, 82e9, 128), "from 1e+08 to 1e+12 Hz"),
    "array in mm": (lambda: scaled(1e3), "144 m; did you mean 144 mm (0.144 m) or 144 cm"),
    "Rx in mm": (lambda: scaled(1.0, 1e3), "an aperture from 0.001 to 5 m, got 141 m"),
    "array / 1000": (lambda: scaled(1e-3), "got 0.000144 m; did you mean 0.144 m?"),
    "overflowing array": (lambda: AntennaArray([[1e308] * 3] * 2, [[-1e308] * 3]), "got inf m"),
    "grid in mm": (lambda: GRID(SIDE, SIDE, FRONT, 1), "340 m; did you mean 340 mm (0.34 m)"),
    "fields in mm": (lambda: VoxelGrid([-100, 0, 260], [1] * 3, (201, 1, 81)), "340 mm (0.34 m)"),
    "grid / 1000": (lambda: GRID((-1e-4, 1e-4), (0, 0), (0, 3e-4), 1e-6), "did you mean 0.3 m?"),
    "step / 1000": (lambda: GRID((-0.1, 0.1), (0, 0), (0.3, 0.3), 1e-6), "did you mean 0.001 m?"),
    "overflowing grid": (lambda: VoxelGrid([0] * 3, [1e308] * 3, (9, 9, 9)), "got inf m"),
}


@pytest.mark.parametrize("name", WRONG)
def test_another_unit_is_refused_and_named(name):
    make, part = WRONG[name]
    with pytest.raises(ModelError) as caught:
        make()
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


RIGHT: dict[str, Callable[[], Any]] = {
    "ends of the band": lambda: Waveform([*PLAUSIBLE_HZ]),
    "body scanner": lambda: AntennaArray(*np.random.default_rng(0).uniform(-1, 1, (2, 500, 3))),
    "chip": lambda: AntennaArray([[0, 0, 0], [4e-3, 0, 0]], [[0, 1e-3, 0], [0, 3e-3, 0]]),
    "one pair": lambda: AntennaArray([[0, 0, 0]], [[1e-4, 0, 0]]),
    "one place": lambda: AntennaArray(np.zeros((3, 3)), np.zeros((3, 3))),
    "yard": lambda: GRID((-40, 40), (0, 0), (1, 99), 0.5),
    "fine": lambda: GRID((-1e-3, 1e-3), (0, 0), (0.299, 0.301), 1e-5),
    "one voxel": lambda: VoxelGrid([0, 0, 0], [1, 1, 1], (1, 1, 1)),
}


@pytest.mark.parametrize("name", RIGHT)
def test_what_radars_have_is_accepted(name):
    RIGHT[name]()

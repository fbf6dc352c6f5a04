"""Hands that are fitted: both parametric ones, and a rig."""

import numpy as np
import pytest
from rig_files import RigMaker

from calibration.hand_fit.hand_model import HandModel, ParametricHand, RiggedHand
from clradar.rigs import read_rig


@pytest.fixture(scope="session")
def hands(tmp_path_factory) -> dict[str, HandModel]:
    """The rig is stretched along each axis, too."""
    turn = np.diag([1.05, 0.95, 1.02])
    maker = RigMaker(turn=turn, local_turns=False, edge_length_m=4e-3)
    return {
        "right": ParametricHand("right", "pocl"),
        "left": ParametricHand("left", "pocl"),
        "rig": RiggedHand(read_rig(maker.save(tmp_path_factory.mktemp("rig") / "rig.glb"))),
    }

"""Which hand a start is fitted as."""

from __future__ import annotations

import pytest
from hand_fits import made_up_fit
from rig_files import RigMaker

from calibration.hand_fit.fit_hand import _sides
from calibration.hand_fit.starts import Start, starts_of
from clradar.hand import POSES
from clradar.rigs import read_rig


@pytest.mark.parametrize(
    ("known", "asked", "sides"),
    [
        (None, "right", ("right",)),
        (None, "left", ("left",)),
        (None, "either", ("right", "left")),
        ("left", "right", ("left",)),
        ("left", "either", ("left",)),
    ],
)
def test_an_earlier_fit_knows_its_hand(
    known: str | None, asked: str, sides: tuple[str, ...]
) -> None:
    assert _sides(Start(POSES["F"], handedness=known), asked, None) == sides


def test_a_rig_is_one_hand(tmp_path) -> None:
    RigMaker().save(tmp_path / "hand.glb")
    rig = read_rig(tmp_path / "hand.glb")
    assert _sides(Start(POSES["F"], handedness="left"), "either", rig) == ("right",)


def test_an_earlier_fit_is_named_and_keeps_the_name_of_its_pose() -> None:
    (start,) = starts_of(made_up_fit("F"))
    assert (start.name, start.pose.name) == ("an earlier fit", "F")
    assert starts_of("f")[0].name == "F"

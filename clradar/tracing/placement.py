"""Where a scene is, seen from the antennas: guards against another unit or another frame."""

from __future__ import annotations

import numpy as np

from clradar.constants import PLAUSIBLE_RANGE_M
from clradar.errors import warn
from clradar.model import AntennaArray, Scene, checks
from clradar.model.plausible import check_plausible, doubtful_place
from clradar.model.scene import PLAUSIBLE_SIZE_M


def bounding_box_m(scene: Scene) -> np.ndarray:
    """Lowest and highest coordinates of the faces, shape (2, 3), metres."""
    used = np.zeros(len(scene.vertices_m), bool)
    used[scene.faces] = True
    vertices_m = scene.vertices_m[used]
    return np.stack([vertices_m.min(axis=0), vertices_m.max(axis=0)])


def check_placement(function: str, scene: Scene, array: AntennaArray) -> None:
    """Raise unless it is a scene, as large and near as one in metres; warn of a doubtful place."""
    checks.instance(f"{function}: scene", scene, Scene)
    checks.instance(f"{function}: array", array, AntennaArray)
    box_m, field = bounding_box_m(scene), f"{function}: scene"
    with np.errstate(over="ignore"):
        size_m = np.ptp(box_m, axis=0).max()
    check_plausible(field, "a size", size_m, (0.0, PLAUSIBLE_SIZE_M[1]))
    farthest_m = np.abs(box_m).max()
    check_plausible(
        field, "a distance of its farthest point", farthest_m, (0.0, PLAUSIBLE_RANGE_M[1])
    )
    if (doubt := doubtful(scene, array)) is not None:
        warn(doubt)


def doubtful(scene: Scene, array: AntennaArray) -> str | None:
    """What there is to doubt about a scene's place and size, seen from the antennas, or None.

    Behind is no error: the antennas of the model radiate to either side alike, so that the result
    is exact for such a scene. But boresight is +z, so that it was most likely meant otherwise.
    """
    box_m = bounding_box_m(scene)
    low_m, high_m = box_m[:, 2]
    antennas_m = np.concatenate([array.tx_m, array.rx_m])
    # Antennas that surround the scene have no side behind them.
    behind_m, front_m = float(antennas_m[:, 2].min()), float(antennas_m[:, 2].max())
    if low_m <= behind_m:
        lies = "lies" if high_m <= behind_m else "reaches"
        return (
            f"the scene {lies} behind the aperture (z = {1e3 * low_m:g} to "
            f"{1e3 * high_m:g} mm; the antennas are at {1e3 * behind_m:g} mm and beyond); is it in "
            "the antenna frame, whose z points away from the radar? Place it with transform"
        )
    size_m = float(np.ptp(box_m, axis=0).max())
    tiny = float(np.abs(box_m).max()) < PLAUSIBLE_RANGE_M[0]
    doubt = (
        doubtful_place(size_m, box_m.mean(axis=0), antennas_m) if low_m > front_m or tiny else None
    )
    return None if doubt is None else f"the scene is {doubt}"

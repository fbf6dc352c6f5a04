"""Small valid files of every kind that is read, always the same: kept ones, and large ones."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import maroon_files
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(__file__).with_name("corpus")
FOLDERS = (CORPUS, ROOT / "tests" / "files" / "frozen" / "2026-11", ROOT)
RADAR = "radar_72.0_82.0_2"


def files(*patterns: str) -> list[bytes]:
    """Return the files with such names in one of the folders above."""
    paths = [path for p in patterns for folder in FOLDERS for path in sorted(folder.glob(p))]
    return [path.read_bytes() for path in paths]


def radar_folder(*names: str) -> dict[str, bytes]:
    """Return what is in the radar folder of a recording, as it lies around an input."""
    return {f"{RADAR}/{name}": files(f"recording/30/{RADAR}/{name}")[0] for name in names}


def frames() -> list[bytes]:
    """Recorded frames: every protocol, both channel counts, the numpy of old and of today."""
    frame = maroon_files.random_frame(1, channels=94)
    rich = frame | {"gain": np.float32(0.5), "phase": 1 + 2j, "note": "hand"}
    rich |= {"list": [1, 2.5, ("a", None)], "objects": np.array([1, "a"], dtype=object)}
    pickles = [
        maroon_files.pickled(rich, protocol, spelling)
        for protocol in maroon_files.PROTOCOLS
        for spelling in maroon_files.SPELLINGS
    ]
    pickles += [maroon_files.pickled(maroon_files.random_frame(1))]
    return [maroon_files.npy(content) for content in pickles]


def of_page(page: str) -> list[bytes]:
    """The longest TOML file of a page of the documentation."""
    (text,) = files(f"docs/{page}")
    return [max((part.split(b"```")[0] for part in text.split(b"```toml\n")[1:]), key=len)]


def hand_models() -> list[bytes]:
    """The MANO model of the corpus, which has three vertices at each joint, as pickles."""
    from mano_files import mano_pickle
    from scipy.sparse import csc_matrix

    model: dict[str, Any] = dict(np.load(CORPUS / "model.npz"), bs_style="lbs")
    model["J_regressor"] = csc_matrix(model["J_regressor"])
    kinds = ((2, True), (0, True), (2, False), (5, False))  # Python 2 and 3
    return [mano_pickle(model, protocol, python_2) for protocol, python_2 in kinds]


def rigs() -> list[bytes]:
    """The hand of this package as a rig, in one primitive and in two."""
    from rig_files import RigMaker

    with TemporaryDirectory() as folder:
        return [RigMaker(primitives=n).save(Path(folder) / "hand.glb").read_bytes() for n in (1, 2)]

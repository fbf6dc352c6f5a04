"""Every public function has a runnable example, which does what it shows; many classes have."""

import doctest
import importlib
import inspect
from typing import Any

import numpy as np
import pytest
from nightly import nightly

import clradar
from clradar.errors import ClradarError
from clradar.hand import HandPose, posed_skeleton
from clradar.hand.skin import Skin
from clradar.rigs import Rig
from clradar.rigs.mano import MANO_JOINTS, PARENTS

PACKAGES = (
    "clradar",
    "clradar.arrays",
    "clradar.hand",
    "clradar.rigs",
    "clradar.dataset",
    "clradar.report",
    "clradar.view",
    "clradar.opencl",
    "measurement_io",
    "calibration",
)
FILES = {
    "plan.toml": """samples = 2
poses.names = ["A", "B"]
output.products = ["joints"]
""",
    "cross60.toml": """[[tx]]
line = { first_m = [-0.0275, 0, 0], last_m = [0.0275, 0, 0], n = 12 }
[[rx]]
line = { first_m = [0, -0.0375, 0], last_m = [0, 0.0375, 0], n = 16 }
""",
    "hook.toml": """name = "hook"
[joints.index-finger-phalanx-intermediate]
flexion_deg = 80
""",
    "motion.toml": "[[body]]\nvelocity_mm_per_s = [0, 0, 500]",
}
"""What the examples read."""

FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def documented() -> dict[str, Any]:
    """Public functions and classes by the name that users import; each once."""
    found: dict[str, Any] = {}
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            item = getattr(module, name)
            error = inspect.isclass(item) and issubclass(item, ClradarError)  # docs/messages.md
            if not error and (inspect.isfunction(item) or inspect.isclass(item)):
                found.setdefault(
                    f"{item.__module__}.{item.__qualname__}", (f"{package}.{name}", item)
                )
    return dict(found.values())


DOCUMENTED = documented()

LONG = (
    *("calibration.align_mesh", "calibration.register", "calibration.sweep"),
    *("calibration.sweep_roughness", "clradar.dataset.TorchDataset", "clradar.dataset.replay"),
    *("clradar.report.html_report", "clradar.spread"),
)
"""What takes seconds, and is tried by tests of its own."""


@pytest.fixture(scope="module")
def namespace() -> dict[str, Any]:
    """What examples use without making it: `capture`, `frames`, `channels`, a `rig` like MANO's."""
    waveform = clradar.Waveform([76e9, 77e9, 78e9])
    array = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]], "lab")
    cycles = waveform.frequencies_hz * 0.6 / clradar.constants.SPEED_OF_LIGHT_M_PER_S
    data = np.exp(-2j * np.pi * cycles) * np.ones((2, 1, 1))  # a path of 0.6 m
    capture = clradar.Capture(data.astype(np.complex64), array, waveform, {"room": "B 12"})
    channels = clradar.ChannelCalibration(
        response=clradar.ChannelResponse([1, 1j], [2], [0, 1e-12], [0], 77e9),
        array=array, waveform=waveform,
        target="corner", target_position={"x_m": 0.0, "y_m": 0.1, "z_m": 0.3},
        target_covariance=np.eye(3), target_amplitude=1.0,
        dead_tx=[], dead_rx=[], noisy_tx=[], noisy_rx=[],
        tx_noise=[0, 0], rx_noise=[0], tx_phase_std_rad=[0.01, 0.01], rx_phase_std_rad=[0.01],
        tx_delay_std_s=[0, 0], rx_delay_std_s=[0], residual_db=-20.0, noise_residual_db=-21.0,
        meta={},
    )  # fmt: skip
    rest, tips = posed_skeleton(HandPose("rest")), [4, 9, 14]
    skin = Skin([0, 1, 2], tips, np.ones(3), np.zeros((3, 3)))
    blend = np.zeros((3, 3, 135))
    rig = Rig("m", "right", 1.0, np.eye(3), rest.joints_m, rest.frames, [[0, 1, 2]], skin, blend)
    data = np.full((94, 94, 3), 1 - 1j, np.complex64)
    qar50, three = clradar.arrays.qar50(), clradar.Waveform([72e9, 77e9, 82e9])
    frames = [clradar.Capture((i + 1) * data, qar50, three) for i in range(3)]
    names = ("clradar", "calibration", "measurement_io")
    packages = {name: importlib.import_module(name) for name in names} | {"np": np}
    return {**packages, "frames": frames, "capture": capture, "channels": channels, "rig": rig}


@pytest.mark.parametrize("name", [n for n in DOCUMENTED if n not in LONG] + nightly(LONG))
def test_example(name, tmp_path, monkeypatch, namespace):
    monkeypatch.chdir(tmp_path)
    for file, text in FILES.items():
        (tmp_path / file).write_text(text)
    at_m = posed_skeleton(HandPose("rest")).joints_m[list(MANO_JOINTS)]
    np.savez(
        tmp_path / "MANO_RIGHT.npz", v_template=1e3 * at_m, shapedirs=np.zeros((16, 3, 1)),
        posedirs=np.zeros((16, 3, 135)), J_regressor=np.eye(16), weights=np.eye(16),
        f=[[1, 4, 7], [2, 5, 8], [3, 6, 9]], kintree_table=[PARENTS, range(16)],
    )  # fmt: skip
    item = DOCUMENTED[name]
    own, *methods = doctest.DocTestFinder().find(item, name, module=False, globs=dict(namespace))
    assert own.examples or inspect.isclass(item), f"{name} has no example in its docstring"
    output: list[str] = []
    for test in (own, *methods):
        doctest.DocTestRunner(optionflags=FLAGS).run(test, out=output.append)
    assert not output, "".join(output)

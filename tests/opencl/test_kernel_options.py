"""Every size that a kernel takes from the host is an option that it demands."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

from clradar.geometry.bvh import TraversalOptions
from clradar.geometry.node_splits import BuildOptions
from clradar.hand import flesh_field
from clradar.imaging import direct_sum, tree_on_device
from clradar.imaging.exact import ExactSizes
from clradar.imaging.samples import SampleSizes
from clradar.imaging.strongest import DepthSizes
from clradar.imaging.tiled import KernelSizes
from clradar.opencl import self_test
from clradar.opencl.sources import source
from clradar.phasors.kirchhoff_sum import KirchhoffOptions
from clradar.phasors.phasor_sum import SynthesizeOptions
from clradar.tracing.antenna_packets import VisibilityOptions
from clradar.tracing.expected import ExpectedOptions
from clradar.tracing.quadrature import QuadratureOptions, RoughnessOptions
from clradar.tracing.sampled_surface import SampleOptions
from clradar.tracing.stochastic import OrderOptions, TraceOptions

ROOT = Path(__file__).parents[2]

KERNELS = {
    "build.cl": BuildOptions,
    "nearest.cl": TraversalOptions,
    "visibility.cl": VisibilityOptions,
    "sample.cl": SampleOptions,
    "trace.cl": TraceOptions,
    "receptions.cl": OrderOptions,
    "expected.cl": ExpectedOptions,
    "synthesize.cl": SynthesizeOptions,
    "backproject_exact.cl": ExactSizes,
    "backproject_range.cl": KernelSizes,
    "tree_sums.cl": tree_on_device._SumSizes,
    "backproject_fast.cl": tree_on_device._KernelSizes,
    "forward_fast.cl": tree_on_device._ForwardSizes,
    "samples.cl": SampleSizes,
    "depth.cl": DepthSizes,
    "direct_sum.cl": direct_sum._Sizes,
    "quadrature.cl": QuadratureOptions,
    "roughness.cl": RoughnessOptions,
    "kirchhoff.cl": KirchhoffOptions,
    "flesh.cl": flesh_field._FleshOptions,
    "self_test.cl": self_test._Width,
}


def test_the_table_has_every_kernel_file():
    assert set(KERNELS) == {path.name for path in (ROOT / "kernels").glob("*.cl")}


@pytest.mark.parametrize("name", KERNELS)
def test_options_are_those_that_the_kernel_demands(name):
    text = re.sub(r"/\*.*?\*/", "", source(name), flags=re.DOTALL)
    named = set(re.findall(r"CLR_\w+", text)) - {"CLR_CHECKED"}
    demanded = set(re.findall(r"(?:#ifndef |!defined\()(CLR_\w+)", text)) - {"CLR_CHECKED"}
    options = {f"CLR_{field.name.upper()}" for field in fields(KERNELS[name])}
    assert options == demanded == named

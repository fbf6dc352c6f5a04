"""Training data: from a plan to shards of samples, each of which can be made again alone.

    plan.toml ──read_plan──> Plan ──recipe(plan, i)──> recipe ──make_sample──> Sample ──> shard

`clradar.dataset.run.run` makes a data set; ``docs/datasets.md`` says what plans can ask for.
"""

from clradar.dataset.make import Sample, make_sample
from clradar.dataset.plan import Plan
from clradar.dataset.plan_reader import read_plan
from clradar.dataset.plan_table import PlanError
from clradar.dataset.recipe import recipe
from clradar.dataset.replay import replay
from clradar.dataset.run import run
from clradar.dataset.torch_dataset import TorchDataset
from clradar.dataset.xarray_view import open_dataset

__all__ = [
    "Plan",
    "PlanError",
    "Sample",
    "TorchDataset",
    "make_sample",
    "open_dataset",
    "read_plan",
    "recipe",
    "replay",
    "run",
]

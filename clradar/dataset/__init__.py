"""Training data: from a plan to shards of samples, each of which can be reproduced alone::

    plan.toml ──read_plan──> Plan ──recipe(plan, i)──> recipe ──make_sample──> Sample ──> shard

`run` makes a data set; ``docs/plans.md`` describes plans and files.
"""

from clradar.dataset.plan.plan import Plan, PlanError, plan_schema, read_plan
from clradar.dataset.readers import TorchDataset, open_dataset, read_sample
from clradar.dataset.runs import replay, run
from clradar.dataset.sample import Sample, make_sample, recipe

__all__ = [
    "Plan",
    "PlanError",
    "Sample",
    "TorchDataset",
    "make_sample",
    "open_dataset",
    "plan_schema",
    "read_plan",
    "read_sample",
    "recipe",
    "replay",
    "run",
]


def __dir__() -> list[str]:
    return sorted(__all__)

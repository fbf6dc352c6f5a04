"""The alpha of meshes and of their named parts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clradar.cli.options.groups import option
from clradar.cli.options.values import wrong_usage
from clradar.errors import ModelError

if TYPE_CHECKING:
    from clradar import Scene

DEFAULT_ALPHA = 0.5


@dataclass(frozen=True, kw_only=True)
class AlphaOptions:
    """The alpha of the meshes, and of named parts."""

    alpha: list[str] | None = option(
        None,
        "0 specular to 1 diffuse; may be repeated for named parts: --alpha palm=0.6. "
        f"[default: {DEFAULT_ALPHA:g}]",
        metavar="ALPHA|PART=ALPHA",
    )


def read_part_alphas(values: Sequence[str]) -> tuple[float, dict[str, float]]:
    """The alpha of the parts that are not named, and that of each named part."""
    default = None
    by_part: dict[str, float] = {}
    for text in values:
        name, equals, number = text.rpartition("=")
        try:
            value = read_alpha("--alpha", number)
        except ValueError:
            raise wrong_usage(
                "--alpha", f"expected a number or PART=number, got '{text}'"
            ) from None
        if equals:
            if name in by_part:
                raise wrong_usage("--alpha", f"part '{name}' is given twice")
            by_part[name] = value
        elif default is not None:
            raise wrong_usage("--alpha", "expected one value without a part's name, got two")
        else:
            default = value
    return DEFAULT_ALPHA if default is None else default, by_part


def read_alpha(option: str, text: str) -> float:
    """The alpha in the text of an option."""
    value = float(text)
    if not (math.isfinite(value) and 0.0 <= value <= 1.0):
        raise wrong_usage(option, f"expected an alpha in [0, 1], got '{text}'")
    return value


def with_part_alphas(scene: Scene, by_part: Mapping[str, float]) -> Scene:
    """The scene with the alpha of each named part; all else keeps its own."""
    unknown = sorted(set(by_part) - set(scene.part_names))
    if unknown:
        raise ModelError(
            f"--alpha: expected parts of the meshes ({', '.join(scene.part_names)}), got "
            f"{', '.join(unknown)}"
        )
    values = np.array(scene.alpha)
    for name, value in by_part.items():
        values[np.asarray(scene.part) == scene.part_names.index(name)] = value
    return scene.with_alpha(values)

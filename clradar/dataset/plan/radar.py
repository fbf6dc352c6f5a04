"""The tables [impairments], [radar], [simulation] and [image] of a plan."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from clradar.arrays import read_array
from clradar.arrays.array_file import array_of, array_record
from clradar.arrays.instruments import KNOWN
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.dataset.plan.draws import Draw, Within, fixed, tried
from clradar.dataset.plan.hands import NAME_OR_TABLE, different, folder_of
from clradar.files.records import FileRecord, Number, Vector, checked, is_number, mistake
from clradar.files.toml_file import choice_text, toml_brief
from clradar.geometry.normals import CREASE_DEG
from clradar.model import AntennaArray, VoxelGrid, Waveform
from clradar.tracing.settings import (
    PHYSICAL_SAMPLES_PER_MM2,
    RECEPTION_RADIUS_M,
    SimulationSettings,
)

DENSITIES_PER_MM2 = {"expected": 0.25, "stochastic": 10.0, "physical": PHYSICAL_SAMPLES_PER_MM2}

RAYS_PER_SAMPLE = 160
"""With the expected estimator: as many rays per square millimetre as the stochastic one has by
default in `simulate`, so amplitudes have its scale."""

DECIBELS = 300.0

Seed = Annotated[int, Within(0, 2**63 - 1)] | None
"""Drawn for every sample, unless it is given."""

Level = Annotated[Draw, Within(-DECIBELS, DECIBELS)]


Direction = Annotated[Vector, checked("a direction", any, AfterValidator)]
Channels = Annotated[tuple[Annotated[int, Within(0, 1023)], ...], AfterValidator(different)]


class ChannelErrors(FileRecord):
    """Gains and delays of an uncalibrated instrument; see `clradar.draw_channels`. With `per`
    "dataset" all samples share one."""

    gain_db: Annotated[float, Within(0.0, DECIBELS)] = 3.0
    phase_deg: Annotated[float, Within(0.0, 180.0)] = 180.0
    delay_ps: Annotated[float, Within(0.0, 1e6)] = 20.0
    dead_tx: Channels = ()
    dead_rx: Channels = ()
    per: Literal["dataset", "sample"] = "dataset"
    seed: Seed = None


class WallPlan(FileRecord):
    """A reflecting wall; see `clradar.Wall`."""

    point_mm: Vector = (0.0, 0.0, 1000.0)
    normal: Direction = (0.0, 0.0, -1.0)
    amplitude: Annotated[float, Within(-1e12, 1e12)] = 1.0


class Impairments(FileRecord):
    """Impairments of captures; None and 0 are off. See `clradar.impair`."""

    snr_db: Level | None = None
    coupling_db: Level | None = None
    coupling_delay_ps: Annotated[Draw, Within(-1e6, 1e6)] = fixed(0.0)
    iq_gain_db: Level = fixed(0.0)
    iq_phase_deg: Annotated[Draw, Within(-180.0, 180.0)] = fixed(0.0)
    adc_bits: Annotated[int, Within(2, 24)] | None = None
    channels: ChannelErrors | None = None
    walls: tuple[WallPlan, ...] = ()
    seed: Seed = None

    @model_validator(mode="after")
    def _check(self) -> Impairments:
        if self.coupling_db is None and self.coupling_delay_ps.bounds() != (0.0, 0.0):
            raise mistake("coupling_db with it", "none", key="coupling_delay_ps")
        return self

    @property
    def any(self) -> bool:
        """Whether a capture changes at all."""
        return self != Impairments(seed=self.seed)


def _array(value: Any, info: ValidationInfo) -> str | dict[str, Any]:
    """A known array's name, or the antennas of a file; the latter as they are in manifests."""
    if isinstance(value, dict):
        return array_record(tried(array_of, value, "array", "array"))
    if isinstance(value, str) and value in KNOWN:
        return value
    if isinstance(value, str) and value.endswith(".toml"):
        return array_record(tried(read_array, folder_of(info) / value))
    expected = f"{choice_text(str(value), tuple(KNOWN))}, or a .toml file of antennas"
    raise mistake(expected, toml_brief(value))


class RadarPlan(FileRecord):
    """The table [radar]: every n-th antenna of a known array ("qar50") or of a file's, and SFCW."""

    array: Annotated[str | Mapping[str, Any], PlainValidator(_array), NAME_OR_TABLE] = "qar50"
    every: Annotated[int, Within(1, 47)] = 1
    start_ghz: Annotated[float, Within(0.1, 1000.0)] = 72.0
    stop_ghz: Annotated[float, Within(0.1, 1000.0)] = 82.0
    steps: Annotated[int, Within(1, 4096)] = 128

    @model_validator(mode="after")
    def _check(self) -> RadarPlan:
        start, stop = self.start_ghz, self.stop_ghz
        if stop < start or (stop == start) != (self.steps == 1):
            expected = "start_ghz < stop_ghz, or both the same with steps = 1"
            raise mistake(expected, f"{start:g}, {stop:g}", key="stop_ghz")
        return self

    @property
    def antennas(self) -> AntennaArray:
        """Every n-th antenna; equal ones are the same object."""
        return _antennas(json.dumps(self.array), self.every)

    @property
    def waveform(self) -> Waveform:
        """The frequencies; equal ones are the same object."""
        return _waveform(self.start_ghz * 1e9, self.stop_ghz * 1e9, self.steps)


_waveform = lru_cache(maxsize=8)(Waveform.sfcw)


@lru_cache(maxsize=8)
def _antennas(array: str, every: int) -> AntennaArray:
    given = json.loads(array)
    antennas = KNOWN[given]() if isinstance(given, str) else array_of(given, "array", "array")
    if every == 1:
        return antennas
    one_in = slice(None, None, every)
    return antennas.part(one_in, one_in, f"{antennas.name}, one in {every}")


class SimulationPlan(FileRecord):
    """The table [simulation]: `clradar.SimulationSettings`, each sample with a seed of its own."""

    estimator: Literal["expected", "stochastic", "physical"] = "expected"
    samples_per_mm2: Annotated[float, Within(0.0, 1e4, above=True)] | None = None
    rays_per_face: Annotated[int, Within(1, 2**20)] | None = None
    rays_per_sample: Annotated[int, Within(1, 2**16)] | None = None
    reception_radius_mm: Annotated[float, Within(0.0, 1e3, above=True)] = 1e3 * RECEPTION_RADIUS_M
    max_bounces: Annotated[int, Within(1, 255)] = 1
    normals: Literal["smooth", "face"] = "smooth"
    crease_deg: Annotated[float, Within(0.0, 180.0)] = CREASE_DEG
    facets: Literal["curved", "flat"] = "curved"
    amplitude: Literal["unit", "spreading"] = "unit"
    pattern_exponent: Annotated[float, Within(0.0, 100.0)] = 0.0
    seed: Seed = None

    @model_validator(mode="after")
    def _check(self) -> SimulationPlan:
        physical, by_face = self.estimator == "physical", self.rays_per_face is not None
        if not by_face and self.samples_per_mm2 is None:
            self.__dict__["samples_per_mm2"] = DENSITIES_PER_MM2[self.estimator]
        if self.rays_per_sample is None and not physical:
            several = RAYS_PER_SAMPLE if self.estimator == "expected" else 4
            self.__dict__["rays_per_sample"] = 1 if by_face else several
        tried(self.settings)
        return self

    def settings(self) -> SimulationSettings:
        values = {**self.__dict__, "seed": self.seed or 0}
        radius_m = values.pop("reception_radius_mm") / 1e3
        return SimulationSettings(**values, reception_radius_m=radius_m)


Extent = Annotated[
    tuple[Number, Number],
    checked("[first, last] with first <= last", lambda ends: ends[0] <= ends[1], AfterValidator),
]
Steps = Annotated[
    Vector,
    checked("a positive step, or three of them", lambda steps: min(steps) > 0, AfterValidator),
    BeforeValidator(lambda value: [value] * 3 if is_number(value) else value),
    WithJsonSchema({"type": ["number", "array"], "items": {"type": "number"}}),
]


class Image(FileRecord):
    """The table [image]: voxel grid, both ends included, and image formation."""

    x_mm: Extent = (-100.0, 100.0)
    y_mm: Extent = (-100.0, 100.0)
    z_mm: Extent = (250.0, 350.0)
    step_mm: Steps = (2.0, 2.0, 2.0)
    method: Literal["exact", "range", "fast"] = "fast"
    window: Literal["rect", "hann", "taylor"] = "rect"
    tolerance_db: Annotated[float, Within(-80.0, -30.0)] | None = None
    dynamic_range_db: Annotated[float, Within(0.0, 300.0, above=True)] = DYNAMIC_RANGE_DB

    @model_validator(mode="after")
    def _check(self) -> Image:
        if self.tolerance_db is not None and self.method != "fast":
            raise mistake('none unless method = "fast"', self.tolerance_db, key="tolerance_db")
        tried(lambda: self.grid)
        return self

    @property
    @lru_cache(maxsize=8)  # noqa: B019 - by value
    def grid(self) -> VoxelGrid:
        """The voxel grid; equal ones are the same object, which image formation makes use of."""
        x_m, y_m, z_m, steps_m = (
            [value / 1e3 for value in own]
            for own in (self.x_mm, self.y_mm, self.z_mm, self.step_mm)
        )
        return VoxelGrid.from_extent(x_m, y_m, z_m, steps_m)

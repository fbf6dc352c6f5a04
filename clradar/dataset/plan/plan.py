"""What a data set is to hold: the records behind a plan file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clradar.dataset.plan.draws import Draw
from clradar.tracing.settings import SimulationSettings

PRODUCTS = ("capture", "volume", "max_projection", "depth_map", "mesh", "joints")
"""What can be kept of a sample."""

IMAGES = ("volume", "max_projection", "depth_map")
"""The products for which an image is formed."""


@dataclass(frozen=True, slots=True)
class Poses:
    """Which poses there are.

    Attributes
    ----------
    kind : "list", "interpolation" or "sampler"
        A pose of the list; a pose between two of them; or a random one within the limits of joints.
    poses : tuple of HandPose
    order : "cycle" or "random"
        Sample i has pose i modulo their number, or a random one.
    share : Draw
        How far an interpolated pose is from the first to the second of its two.
    """

    kind: str
    poses: tuple[Any, ...]
    order: str
    share: Draw


@dataclass(frozen=True, slots=True)
class RigFile:
    """A hand that somebody brought, as a file; see `clradar.rigs.read_rig`.

    Attributes
    ----------
    file : str
        As the plan has it; relative to the plan's folder, see `Plan.folder`.
    sha256 : str
        Of its content.
    handedness : "right" or "left"
        Whose it is, as given or as found.
    mapping : str or None
        The file that gives its joints their names, likewise.
    mapping_sha256 : str or None
    unit : str, float or None
    betas : tuple of float
        Shape of a MANO hand.
    """

    file: str
    sha256: str
    handedness: str
    mapping: str | None = None
    mapping_sha256: str | None = None
    unit: str | float | None = None
    betas: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Hands:
    """Whose hands.

    Attributes
    ----------
    handedness : "right", "left", "both" or "as it is"
        Both are as likely. A rig that is of the other hand is mirrored; "as it is" leaves rigs as
        they are.
    shape : "default", "sampled" or "list"
    shapes : tuple of HandShape
        Of "list"; each is as likely.
    rigs : tuple of RigFile
        Instead of shapes; each is as likely.
    edge_mm : float
    """

    handedness: str
    shape: str
    shapes: tuple[Any, ...]
    rigs: tuple[RigFile, ...]
    edge_mm: float


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the centre of a hand's bounding box is, and how the hand is turned about it."""

    x_mm: Draw
    y_mm: Draw
    z_mm: Draw
    rotation_x_deg: Draw
    rotation_y_deg: Draw
    rotation_z_deg: Draw


@dataclass(frozen=True, slots=True)
class Alpha:
    """How rough a hand is.

    Attributes
    ----------
    parts : mapping of str to Draw
        Of the parts that have an alpha of their own.
    others : Draw
        Of all other parts, one value for all of them.
    """

    parts: Mapping[str, Draw]
    others: Draw


@dataclass(frozen=True, slots=True)
class ChannelErrors:
    """Gains and delays of an instrument that nobody has calibrated; see `clradar.draw_channels`.

    Attributes
    ----------
    per : "dataset" or "sample"
        Whether all samples share one instrument.
    """

    gain_db: float
    phase_deg: float
    delay_ps: float
    dead_tx: tuple[int, ...]
    dead_rx: tuple[int, ...]
    per: str


@dataclass(frozen=True, slots=True)
class WallPlan:
    """A mirror behind the scene; see `clradar.Wall`."""

    point_mm: tuple[float, ...]
    normal: tuple[float, ...]
    amplitude: float


@dataclass(frozen=True, slots=True)
class Impairments:
    """What makes captures look recorded; None and 0 are off. See `clradar.impair`."""

    snr_db: Draw | None
    coupling_db: Draw | None
    coupling_delay_ps: Draw
    iq_gain_db: Draw
    iq_phase_deg: Draw
    adc_bits: int | None
    channels: ChannelErrors | None
    walls: tuple[WallPlan, ...]

    @property
    def any(self) -> bool:
        """Whether a capture changes at all."""
        quadrature = (self.iq_gain_db, self.iq_phase_deg)
        return (
            any(v is not None for v in (self.snr_db, self.coupling_db, self.adc_bits))
            or any(d.bounds() != (0.0, 0.0) for d in quadrature)
            or self.channels is not None
            or bool(self.walls)
        )


@dataclass(frozen=True, slots=True)
class Radar:
    """Which instrument.

    Attributes
    ----------
    array : "qar50"
    every : int
        Use every n-th transmitter and receiver: 1 is all of them.
    """

    array: str
    every: int
    start_ghz: float
    stop_ghz: float
    steps: int


@dataclass(frozen=True, slots=True)
class Image:
    """The voxel grid, both ends included, and how the image is formed on it."""

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    z_mm: tuple[float, float]
    step_mm: tuple[float, float, float]
    method: str
    window: str
    tolerance_db: float | None
    dynamic_range_db: float


@dataclass(frozen=True, slots=True)
class Output:
    """What is kept, and how.

    Attributes
    ----------
    products : tuple of str
        Of `PRODUCTS`, in that order.
    shard_size : int
        Consecutive samples that go into one file.
    compression : int
        Level of gzip, 0 to 9.
    """

    products: tuple[str, ...]
    shard_size: int
    compression: int


@dataclass(frozen=True, slots=True)
class Plan:
    """A data set as a plan file describes it, with everything that it left out filled in.

    Make one with `clradar.dataset.read_plan`.

    Attributes
    ----------
    simulation : SimulationSettings
        Resolved; each sample draws a seed of its own.
    folder : Path
        What the names of rig files are relative to. Not a part of what the plan says: a plan in
        another folder is the same plan.
    """

    seed: int
    samples: int
    poses: Poses
    hands: Hands
    placement: Placement
    alpha: Alpha
    impairments: Impairments
    radar: Radar
    simulation: SimulationSettings
    image: Image
    output: Output
    folder: Path = field(default=Path(), compare=False)

    @property
    def n_shards(self) -> int:
        return -(-self.samples // self.output.shard_size)

    def shard_samples(self, shard: int) -> range:
        """Return the indices of the samples that one shard is for."""
        first = shard * self.output.shard_size
        return range(first, min(first + self.output.shard_size, self.samples))

    @property
    def keeps_images(self) -> bool:
        return any(product in IMAGES for product in self.output.products)

    @property
    def needs_capture(self) -> bool:
        return self.keeps_images or "capture" in self.output.products

"""Records of a plan: poses, hands, placement, roughness, radar, simulation, image, output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from clradar.dataset.plan.draws import Draw
from clradar.model import Material
from clradar.tracing.settings import SimulationSettings

PRODUCTS = ("capture", "volume", "max_projection", "depth_map", "mesh", "joints")
"""Arrays that can be stored of a sample."""

IMAGES = ("volume", "max_projection", "depth_map")
"""Products that need an image."""


@dataclass(frozen=True, slots=True)
class Poses:
    """The table [poses].

    Attributes
    ----------
    kind : "list", "interpolation", "around" or "sampler"
        A pose of the list; a pose between two of them; one drawn around a pose of the list; or a
        random one within the limits of joints.
    poses : tuple of HandPose
    order : "cycle" or "random"
        Sample i has pose i modulo their number, or a random one.
    share : Draw
        Interpolation parameter: 0 is the first of the two poses, 1 the second.
    spread_deg : float
        Standard deviation of "around"; see `clradar.hand.pose_around`.
    """

    kind: str
    poses: tuple[Any, ...]
    order: str
    share: Draw
    spread_deg: float


@dataclass(frozen=True, slots=True)
class RigFile:
    """A rigged hand from a file; see `clradar.rigs.read_rig`.

    Attributes
    ----------
    file : str
        Relative to `Plan.folder`.
    sha256 : str
        Of its content.
    handedness : "right" or "left"
        Given, or estimated.
    mapping : str or None
        File with the names of its joints, relative likewise.
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
    """The table [hands].

    Attributes
    ----------
    handedness : "right", "left", "both" or "as it is"
        "both": with equal probabilities. A rig of the other hand is mirrored, unless "as it is".
    shape : "default", "sampled" or "list"
    shapes : tuple of HandShape
        Of "list", with equal probabilities.
    rigs : tuple of RigFile
        Instead of shapes, with equal probabilities.
    edge_mm : float
    """

    handedness: str
    shape: str
    shapes: tuple[Any, ...]
    rigs: tuple[RigFile, ...]
    edge_mm: float


@dataclass(frozen=True, slots=True)
class Placement:
    """The table [placement]: centre of the hand's bounding box, and rotation about it."""

    x_mm: Draw
    y_mm: Draw
    z_mm: Draw
    rotation_x_deg: Draw
    rotation_y_deg: Draw
    rotation_z_deg: Draw


@dataclass(frozen=True, slots=True)
class Alpha:
    """Roughness of a hand, by part; `others` is one value for all parts without their own."""

    parts: Mapping[str, Draw]
    others: Draw


@dataclass(frozen=True, slots=True)
class PartMaterial:
    """What a part of a hand is made of: a material, of which some lengths may be drawn."""

    of: Material
    roughness_rms_mm: Draw | None = None
    correlation_length_mm: Draw | None = None
    coating_thickness_mm: Draw | None = None

    @property
    def draws(self) -> dict[str, Draw]:
        """What is drawn, by its key in a plan."""
        return {f.name: d for f in fields(self) if isinstance(d := getattr(self, f.name), Draw)}

    def drawn(self, lengths_mm: Mapping[str, float]) -> Material:
        """Return the material with these lengths in place of its own."""
        values: dict[str, Any] = {
            name.replace("_mm", "_m"): length_mm / 1e3 for name, length_mm in lengths_mm.items()
        }
        thickness_m = values.pop("coating_thickness_m", None)
        if thickness_m is not None and self.of.coating is not None:
            values["coating"] = replace(self.of.coating, thickness_m=thickness_m)
        return replace(self.of, **values)

    def extremes(self) -> tuple[Material, Material]:
        """Return the materials of the least and of the greatest lengths."""
        least, greatest = (
            self.drawn({name: draw.bounds()[end] for name, draw in self.draws.items()})
            for end in (0, 1)
        )
        return least, greatest


@dataclass(frozen=True, slots=True)
class PlanMaterials:
    """What a hand is made of, by part; `others` is one value for all parts without their own."""

    parts: Mapping[str, PartMaterial]
    others: PartMaterial


@dataclass(frozen=True, slots=True)
class ChannelErrors:
    """Gains and delays of an uncalibrated instrument; see `clradar.draw_channels`.

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
    """A reflecting wall; see `clradar.Wall`."""

    point_mm: tuple[float, ...]
    normal: tuple[float, ...]
    amplitude: float


@dataclass(frozen=True, slots=True)
class Impairments:
    """Impairments of captures; None and 0 are off. See `clradar.impair`."""

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
class RadarPlan:
    """The table [radar].

    Attributes
    ----------
    array : str or mapping
        "qar50", or a table as `clradar.arrays.array_file.array_record` returns it.
    every : int
        Every n-th of its transmitters and receivers.
    start_ghz, stop_ghz : float
    steps : int
    """

    array: str | Mapping[str, Any]
    every: int
    start_ghz: float
    stop_ghz: float
    steps: int


@dataclass(frozen=True, slots=True)
class Image:
    """The table [image]: voxel grid, both ends included, and image formation."""

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
    """The table [output]: `PRODUCTS` to store, samples per shard, and level of gzip, 0 to 9."""

    products: tuple[str, ...]
    shard_size: int
    compression: int


@dataclass(frozen=True, slots=True)
class MovementPlan:
    """The table [movement]: consecutive samples are the frames of a sequence.

    Attributes
    ----------
    frames : int
        Of a sequence.
    rate_hz : float
    poses : "next" or "stay"
        The hand goes from its pose to another, drawn like it, until the last frame; or keeps it.
    x_mm, ..., rotation_z_deg : Draw
        How far the hand has moved and turned in the last frame.
    order, step_us : str, float
        When samples are recorded, as `clradar.SweepTiming.in_order` takes them.
    """

    frames: int
    rate_hz: float
    poses: str
    x_mm: Draw
    y_mm: Draw
    z_mm: Draw
    rotation_x_deg: Draw
    rotation_y_deg: Draw
    rotation_z_deg: Draw
    order: str
    step_us: float


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of a data set with all defaults filled in, as `read_plan` returns it.

    Attributes
    ----------
    simulation : SimulationSettings
        Resolved; each sample draws a seed of its own.
    alpha : Alpha or None
        None with the physical estimator.
    material : PlanMaterials or None
        Of the physical estimator.
    movement : MovementPlan or None
    folder : Path
        What the names of rig files are relative to. It does not count in comparisons: the same
        plan in another folder is equal.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import read_plan
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> plan = read_plan("plan.toml")
    >>> plan.n_shards, plan.shard_samples(0), [pose.name for pose in plan.poses.poses]
    (1, range(0, 2), ['A', 'B'])
    """

    seed: int
    samples: int
    poses: Poses
    hands: Hands
    placement: Placement
    alpha: Alpha | None
    impairments: Impairments
    radar: RadarPlan
    simulation: SimulationSettings
    image: Image
    output: Output
    material: PlanMaterials | None = None
    movement: MovementPlan | None = None
    folder: Path = field(default=Path(), compare=False)

    @property
    def n_shards(self) -> int:
        return -(-self.samples // self.output.shard_size)

    def shard_samples(self, shard: int) -> range:
        """Return the indices of the samples of one shard."""
        first = shard * self.output.shard_size
        return range(first, min(first + self.output.shard_size, self.samples))

    @property
    def keeps_images(self) -> bool:
        return any(product in IMAGES for product in self.output.products)

    @property
    def needs_capture(self) -> bool:
        return self.keeps_images or "capture" in self.output.products

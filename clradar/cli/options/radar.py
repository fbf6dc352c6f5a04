"""Options of the radar: its antennas and its frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.cli.options.groups import option
from clradar.cli.options.values import check_unit, finite, numbers, wrong_usage
from clradar.constants import PLAUSIBLE_HZ

if TYPE_CHECKING:
    from clradar import AntennaArray, Waveform

START_GHZ, STOP_GHZ, STEPS = 72.0, 82.0, 128

ARRAY_HELP = "Antennas: a .toml file (docs/arrays.md), or qar50, the 94 x 94 imager."


@dataclass(frozen=True, kw_only=True)
class BandOptions:
    """The frequencies of a stepped-frequency sweep."""

    band: str | None = option(
        None,
        f"First and last frequency, GHz, and their number. "
        f"[default: {START_GHZ:g}:{STOP_GHZ:g}:{STEPS}]",
        metavar="FIRST:LAST:STEPS",
    )

    @property
    def band_ghz(self) -> tuple[float, float, int]:
        """First and last frequency in gigahertz, and their number."""
        if self.band is None:
            return START_GHZ, STOP_GHZ, STEPS
        values = numbers(self.band, ":")
        if len(values) != 3 or not finite(values) or values[2] % 1:
            raise wrong_usage("--band", f"expected FIRST:LAST:STEPS, got '{self.band}'")
        for value in values[:2]:
            check_unit("--band", "a frequency", value, PLAUSIBLE_HZ, "GHz")
        first, last, steps = values[0], values[1], int(values[2])
        if steps < 1 or (first >= last if steps > 1 else first != last):
            expected = (
                "FIRST below LAST, or both equal for one step" if steps > 0 else "STEPS from 1"
            )
            raise wrong_usage("--band", f"expected {expected}, got '{self.band}'")
        return first, last, steps

    def waveform(self) -> Waveform:
        """The frequencies, those of the paper without the option."""
        from clradar.model import Waveform

        start_ghz, stop_ghz, steps = self.band_ghz
        return Waveform.sfcw(start_ghz * 1e9, stop_ghz * 1e9, steps)


@dataclass(frozen=True, kw_only=True)
class RadarOptions(BandOptions):
    """The antennas and the frequencies."""

    array: str | None = option(None, f"{ARRAY_HELP} [default: qar50]", metavar="ARRAY")

    @property
    def files(self) -> list[Path]:
        """The file of the array, if there is one."""
        from clradar.arrays.instruments import KNOWN

        return [] if self.array is None or self.array in KNOWN else [Path(self.array)]

    def antennas(self) -> AntennaArray:
        """The array, the imager's without the option."""
        from clradar import arrays
        from clradar.arrays.instruments import KNOWN

        name = "qar50" if self.array is None else self.array
        return KNOWN[name]() if name in KNOWN else arrays.read_array(name)

    def clusters(self) -> tuple[AntennaArray, ...]:
        """The arrays of a file of clusters, each of which has a capture of its own; else one."""
        from clradar import arrays

        return arrays.read_clusters(str(self.array)) if self.files else (self.antennas(),)

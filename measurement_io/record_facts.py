"""Descriptions of records: facts as text and as values in SI units."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from textwrap import TextWrapper, shorten
from typing import Any

import numpy as np

from clradar.files.failures import clean
from clradar.model import AntennaArray, Capture, ChannelCalibration, Volume, Waveform
from clradar.model.length_unit import unit_for
from clradar.model.range_profile import MIN_STEPS, echo_profile
from clradar.model.resolution import lateral_resolution_m

_COLUMNS, _META_LINES, _META_CHARACTERS = 79, 40, 60


@dataclass(frozen=True, slots=True)
class Fact:
    """One fact of a description.

    Attributes
    ----------
    name : str
        Such as "array".
    words : str
        Text of one or several lines.
    value : JSON value
        The same in SI units; None for "none".
    """

    name: str
    words: str
    value: Any


@dataclass(frozen=True, slots=True)
class Description:
    """Description of a file or a recording.

    Attributes
    ----------
    path : str
    kind : str
        "native capture", "native volume", "native channels", "recorded frame" or "recording".
    facts : tuple of Fact
    problems : tuple of str
        What contradicts itself or cannot be read.
    missing : tuple of str
        What a recording could have and has not, which is no fault.
    template : str
        Of a layout, for the file of another program; else empty.
    """

    path: str
    kind: str
    facts: tuple[Fact, ...]
    problems: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    template: str = ""

    @property
    def words(self) -> dict[str, str]:
        """The facts in words, by name."""
        return {fact.name: fact.words for fact in self.facts}

    @property
    def values(self) -> dict[str, Any]:
        """The facts as JSON values, with underscores in their names."""
        return {fact.name.replace(" ", "_"): fact.value for fact in self.facts}

    def to_dict(self) -> dict[str, Any]:
        """All of it as strict JSON."""
        return {
            "path": self.path,
            "kind": self.kind,
            "facts": {key: _strict(value) for key, value in self.values.items()},
            "missing": list(self.missing),
            "problems": list(self.problems),
            **({"template": self.template} if self.template else {}),
        }

    def __str__(self) -> str:
        width = max((len(fact.name) for fact in self.facts), default=0)
        lines = [f"{self.path}: {self.kind}"]
        wrapper = TextWrapper(_COLUMNS, break_long_words=False, break_on_hyphens=False)
        for fact in self.facts:
            if self.missing and fact.words == "none":  # said below
                continue
            wrapper.initial_indent = f"  {fact.name:<{width}}  "
            wrapper.subsequent_indent = " " * (width + 4)
            for line in fact.words.split("\n"):
                lines += wrapper.wrap(line) or [wrapper.initial_indent]
                wrapper.initial_indent = wrapper.subsequent_indent
        lines += [f"  missing: {'; '.join(self.missing)}"] if self.missing else []
        lines += [f"  problem: {line}" for line in self.problems]
        lines += ["", self.template.rstrip("\n")] if self.template else []
        return "\n".join(lines)


def facts_of(record: Capture | Volume | ChannelCalibration) -> list[Fact]:
    """Describe a record."""
    if isinstance(record, Capture):
        facts = _instrument_facts(record.array, record.waveform)
        facts += _data_facts(record, "tx rx freq")
        facts += [_ABSOLUTE] if record.absolute else []
        facts += _range_facts(record)
    elif isinstance(record, Volume):
        facts = _volume_facts(record)
    else:
        facts = _channels_facts(record)
    meta = record.meta
    return [*facts, Fact("provenance", mapping_text(meta), meta)] if meta else facts


def _fact(name: str, text: str, /, **value: Any) -> Fact:
    """Return a fact whose text has its values in braces."""
    return Fact(name, text.format(**value), value)


def _data_facts(record: Capture | Volume, axes: str) -> list[Fact]:
    names, shape = axes.split(), record.data.shape
    value = {"shape": list(shape), "type": "complex64", "axes": names}
    amplitude = np.abs(record.data)
    levels = _fact(
        "amplitude",
        "min {min:.4g}, mean {mean:.4g}, rms {rms:.4g}, max {max:.4g}; {zeros} of {size} are zero",
        min=float(amplitude.min()),
        mean=float(amplitude.mean(dtype=np.float64)),
        rms=float(np.sqrt(np.mean(np.square(amplitude, dtype=np.float64)))),
        max=float(amplitude.max()),
        zeros=int(amplitude.size - np.count_nonzero(amplitude)),
        size=int(amplitude.size),
    )
    return [Fact("data", f"{shape} complex64 [{', '.join(names)}]", value), levels]


def _instrument_facts(array: AntennaArray, waveform: Waveform) -> list[Fact]:
    name, text = clean(array.name), "{name}: {n_tx} Tx, {n_rx} Rx"
    facts = [_fact("array", text, name=name, n_tx=array.n_tx, n_rx=array.n_rx)]
    for side, own in zip(("Tx", "Rx"), array.sides, strict=True):
        if (pattern := own.pattern) is not None:
            lobe = f"cos^{pattern.exponent:g}" if pattern.exponent else "the same all around"
            if pattern.angle_deg is not None:
                lobe = f"a table of {len(pattern.angle_deg)} angles"
            value = {"gain_dbi": pattern.gain_dbi, "exponent": pattern.exponent}
            facts.append(_fact(f"{side} pattern", f"{{gain_dbi:g}} dBi, {lobe}", **value))
        if own.gain is not None:
            level_db = 20 * np.log10(np.maximum(np.abs(own.gain), 1e-15))
            span_db = [round(float(v), 3) for v in (level_db.min(), level_db.max())]
            text = "{span_db[0]:g} to {span_db[1]:g} dB"
            facts.append(_fact(f"{side} gains", text, span_db=span_db))
        if own.boresight is not None:
            degrees = np.rad2deg(np.arccos(np.clip(own.boresight[:, 2], -1, 1)))
            most = round(float(degrees.max()), 3)
            text = "up to {most_deg:g} degrees off +z"
            facts.append(_fact(f"{side} boresight", text, most_deg=most))
    size_m = np.ptp(np.concatenate([array.tx_m, array.rx_m]), axis=0).tolist()
    text = " x ".join(f"{1e3 * s:.6g}" for s in size_m) + " mm (x, y, z)"
    low, high = (float(f) for f in waveform.frequencies_hz[[0, -1]])
    band = f"{waveform.n_freq} from {low / 1e9:.6g} to {high / 1e9:.6g} GHz"
    value = {"count": waveform.n_freq, "low_hz": low, "high_hz": high}
    return [*facts, Fact("aperture", text, {"size_m": size_m}), Fact("frequencies", band, value)]


def _range_facts(capture: Capture) -> list[Fact]:
    waveform = capture.waveform
    if waveform.n_freq == 1:
        return [Fact("range", "none, of a single frequency", None)]
    cell_m, period_m = waveform.range_resolution_m, waveform.unambiguous_range_m
    text = f"resolution {_length(cell_m)}, unambiguous to {_length(period_m)}"
    facts = [Fact("range", text, {"resolution_m": cell_m, "unambiguous_m": period_m})]
    if waveform.n_freq < MIN_STEPS:
        return facts
    profile = echo_profile(capture)
    if profile is None:
        text = "none above the noise beyond the direct coupling"
        return [*facts, Fact("strongest echo", text, None)]
    range_m = float(profile.path_m[0]) / 2
    across_m = [lateral_resolution_m(capture, axis, range_m) for axis in (0, 1)]
    lateral = " x ".join(_length(a) if np.isfinite(a) else "none" for a in across_m)
    text = f"at {_length(range_m)} (half path length, mean over pairs); resolution across {lateral}"
    value = {"range_m": range_m, "lateral_resolution_m": across_m}
    return [*facts, Fact("strongest echo", text, value)]


def _volume_facts(volume: Volume) -> list[Fact]:
    axes = [getattr(volume.grid, f"{name}_m") for name in "xyz"]
    unit = unit_for(*(float(axis[i]) for axis in axes for i in (0, -1)))
    facts = []
    for name, values, step in zip("xyz", axes, volume.grid.spacing_m, strict=True):
        first, last = float(values[0]), float(values[-1])
        text = (
            f"{len(values)} voxels from {first * unit.per_m:.6g} to {last * unit.per_m:.6g} "
            f"{unit.name}, every {step * unit.per_m:.6g} {unit.name}"
        )
        value = {"count": len(values), "first_m": first, "last_m": last, "spacing_m": float(step)}
        facts.append(Fact(f"{name} axis", text, value))

    def strongest(values: np.ndarray) -> tuple[list[float], str]:
        at = np.unravel_index(int(values.argmax()), values.shape)[::-1]
        place_m = [float(axis[i]) for axis, i in zip(axes, at, strict=True)]
        text = ", ".join(f"{n} {p * unit.per_m:.6g}" for n, p in zip("xyz", place_m, strict=True))
        return place_m, f"{text} {unit.name}"

    facts += _data_facts(volume, "z y x")
    peak_m, text = strongest(np.abs(volume.data))
    facts.append(Fact("strongest voxel", text, {"position_m": peak_m}))
    if volume.scale is not None and volume.data.any():
        rcs_dbsm = volume.rcs_dbsm()
        dbsm, (place_m, text) = float(rcs_dbsm.max()), strongest(rcs_dbsm)
        text = f"{{dbsm:.1f}} dBsm as a point target, at {text}"
        facts += [_ABSOLUTE, _fact("strongest target", text, dbsm=dbsm, position_m=place_m)]
    return facts


def _channels_facts(channels: ChannelCalibration) -> list[Fact]:
    facts = _instrument_facts(channels.array, channels.waveform)
    for side in ("tx", "rx"):
        for state in ("dead", "noisy"):
            listed = getattr(channels, f"{state}_{side}").tolist()
            text = ", ".join(map(str, listed)) or "none"
            facts.append(Fact(f"{state} {side.title()}", text, listed))
        gain = np.abs(getattr(channels.response, f"{side}_gain"))
        live = gain > 0
        if not live.any():
            facts.append(Fact(f"live {side.title()}", "none", {"count": 0}))
            continue
        gain_db = 20 * np.log10(gain[live])
        delay_s = getattr(channels.response, f"{side}_delay_s")[live]
        noise_db = 20 * np.log10(np.median(getattr(channels, f"{side}_noise")[live]) + 1e-30)
        text = (
            f"{{count}} of {gain.size}: gain {{gain_db[0]:+.2f}} to {{gain_db[1]:+.2f}} dB, noise "
            f"{{noise_db:.1f}} dB, delay {1e12 * delay_s.min():+.2f} to "
            f"{1e12 * delay_s.max():+.2f} ps"
        )
        ends = {"gain_db": gain_db, "delay_s": delay_s}
        value: dict[str, Any] = {n: [float(v.min()), float(v.max())] for n, v in ends.items()}
        value |= {"count": int(gain_db.size), "noise_db": float(noise_db)}
        facts.append(_fact(f"live {side.title()}", text, **value))
    for name, number in channels.target_position.items():
        what, _, unit = clean(name).rpartition("_")
        scale, shown_unit = (1e3, "mm") if unit == "m" else (1.0, unit)
        std = channels.target_std[name]
        digits = 3 if std == 0 else max(0, 1 - math.floor(math.log10(scale * std)))
        text = f"{scale * number:.{digits}f} ± {scale * std:.{digits}f} {shown_unit}"
        place = {"value": number, "std": std, "unit": unit}
        facts.append(Fact(f"{clean(channels.target)} {what}", text, place))
    left = {"db": channels.residual_db, "noise_db": channels.noise_residual_db}
    return [*facts, _fact("residual", "{db:.1f} dB, by noise alone {noise_db:.1f} dB", **left)]


_ABSOLUTE = Fact("scale", "absolute: S-parameters", {"absolute": True})


def _length(length_m: float) -> str:
    return f"{length_m:.4g} m" if length_m >= 1 else f"{1e3 * length_m:.3g} mm"


def mapping_text(mapping: Mapping[str, Any]) -> str:
    """Return a mapping as text, an entry on each line, cut where it is long."""
    lines = []
    for key, value in list(mapping.items())[:_META_LINES]:
        text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        lines.append(shorten(f"{clean(key)}: {clean(text)}", _META_CHARACTERS, placeholder=" …"))
    if len(mapping) > _META_LINES:
        lines.append(f"and {len(mapping) - _META_LINES} more entries")
    return "\n".join(lines)


def _strict(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value

"""The template of a layout: every setting with what it is for, and the keys of a file."""

from __future__ import annotations

from collections.abc import Iterable

from measurement_io.layouts.lab_file import Key

_LISTED = 200

_SETTINGS = """\
[data]
key = "?"  # of the complex numbers; of two keys: real = "..." and imag = "..."
axes = ["tx", "rx", "freq"]  # of this file, in its order; also "pair", "frame", "part", "one"
# pair_order = "tx_major"  # of an axis "pair": all Rx of the first Tx come first; or "rx_major"
# pick = {chirp = 0}  # of any other axis: the index that is used
phase_sign = -1  # exp(-j 2 pi f d / c); +1 for its conjugate: `clradar diagnose` finds out

[tx]  # and the same under [rx]
key = "?"  # of the positions; or x, y and z: keys or numbers; or values, file, array = "qar50"
# orientation = "columns"  # of key, where every antenna is a column
# channels = 96  # on the data's axis, where the positions do not say it
# select = "1:95"  # of these channels: a slice, as in Python, or a list

[rx]
key = "?"

[antennas]  # x to the right of a person who faces the radar, y up, z away from it
unit = "?"  # m, cm, mm, um
# columns = ["x", "y"]  # of key, values or file; others are numbers under [tx] and [rx]
# origin = [0.0, 0.0, 0.0]  # centre of the aperture in the file's frame and unit
# mirror = ["x"]  # coordinates whose sign is turned

[frequency]
key = "?"  # or values; or start, points and either stop or step: numbers, or keys of them
unit = "?"  # Hz, kHz, MHz, GHz

# [meta]
# keys = []  # whose numbers and text are kept with the capture
"""


def layout_template(kind: str, keys: Iterable[Key]) -> str:
    """Return a layout for a file of this kind, with its keys as comments and "?" to fill in."""
    listed = list(keys)
    lines = [f"# Layout of {kind} with these keys:"]
    lines += [f"#   {key}" for key in listed[:_LISTED]]
    if len(listed) > _LISTED:
        lines.append(f"#   and {len(listed) - _LISTED} more")
    lines.append('# Fill in every "?"; docs/layouts.md explains all settings.')
    return "\n".join(lines) + "\n\n" + _SETTINGS

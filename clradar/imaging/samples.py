"""Samples on the device as the tree of blocks reads them: host side of ``kernels/samples.cl``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.imaging.tree_on_device import column_unit, padded
from clradar.opencl import Buffers, build
from clradar.opencl.buffers import hi_lo


@dataclass(frozen=True, slots=True)
class SampleSizes:
    """Compile-time constants."""

    width: int


class SampleCube:
    """The weighted samples of some antennas, (n_freq, n_tx, 2, padded n_rx), float32.

    `tx` and `rx` are slices of all antennas, `n_all_rx` counts the receivers of the whole capture,
    and `weights` are over frequency.
    """

    def __init__(
        self, tx: slice, rx: slice, n_all_rx: int, weights: np.ndarray, buffers: Buffers
    ) -> None:
        self._first = (tx.start, rx.start, n_all_rx)
        self._n_tx, self._n_rx, self._n_freq = tx.stop - tx.start, rx.stop - rx.start, len(weights)
        device = buffers.device
        self._program = build(device, "samples.cl", SampleSizes(device.width))
        self._n_columns = padded(self._n_rx, column_unit(device))
        self._weights = buffers.upload(np.stack(hi_lo(weights)))
        self.buffer = buffers.empty(8 * self._n_freq * self._n_tx * self._n_columns)
        self._buffers = buffers

    def fill(self, samples: Any, stride: int | None = None) -> Any:
        """Write the cube from all samples on the device, and return its buffer.

        They are complex64 (n_all_tx, n_all_rx, stride), n_freq of them if it is not given.
        """
        u, width = np.uint32, self._buffers.device.width
        self._program.start(
            "transpose_samples", (self._n_columns // width, self._n_tx), u(self._n_freq),
            u(self._n_tx), u(self._n_rx), u(self._n_columns), *(u(n) for n in self._first),
            u(stride or self._n_freq), samples, self._weights, self.buffer,
            work=10.0 * self._n_freq,
        )  # fmt: skip
        return self.buffer

    def release(self) -> None:
        for buffer in (self._weights, self.buffer):
            self._buffers.release(buffer)

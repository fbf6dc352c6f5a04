"""Images of frame after frame: the bits of `backproject`, and what crosses the bus for them."""

from typing import Any

import numpy as np
import pyopencl
import pytest
import trimesh
from images import QAR50, noise

import clradar
from clradar import Capture, FrameImager, VoxelGrid
from clradar.errors import ModelError
from clradar.imaging import fast
from clradar.phasors.phasor_sum import PhasorSum

SWEEP = clradar.Waveform.sfcw(72e9, 82e9, 32)
THIN = clradar.AntennaArray(QAR50.tx_m[::6], QAR50.rx_m[::6])
GRID = VoxelGrid.from_extent((-0.04, 0.04), (-0.03, 0.05), (0.27, 0.31), 2e-3)


pytestmark = pytest.mark.usefixtures("always_a_tree")


@pytest.fixture(scope="module")
def frames() -> list[Capture]:
    """Echoes of a few points at other places each, and noise."""
    rng = np.random.default_rng(3)
    made = []
    for _ in range(2):
        points_m = rng.uniform([-0.03, -0.02, 0.28], [0.03, 0.04, 0.30], (5, 3))
        made.append(clradar.room_capture(THIN, SWEEP, [], points_m=points_m))
    return [*made, noise(THIN, SWEEP, seed=5)]


@pytest.mark.parametrize(
    ("method", "window"), [("fast", "rect"), ("fast", "hann"), ("range", "rect"), ("exact", "rect")]
)
def test_frames_have_the_bits_of_single_images(frames, method, window, device):
    """Whatever was imaged before."""
    grid = GRID if method == "fast" else VoxelGrid(GRID.origin_m, GRID.spacing_m, (9, 8, 7))
    options: dict[str, Any] = {"method": method, "window": window, "device": device}
    with FrameImager(THIN, SWEEP, grid, **options) as imager:
        for frame in (*frames, frames[0]):
            imager.form(frame)
            alone = clradar.backproject(frame, grid, check_grid=False, **options)
            np.testing.assert_array_equal(imager.volume().data, alone.data)
            assert imager.volume().meta == alone.meta
            shown, depth = imager.depth_map(20.0), alone.depth_map(20.0)
            # The strongest voxel is found in float32 on the device.
            np.testing.assert_allclose(shown.depth_m, depth.depth_m, rtol=1e-6)
            np.testing.assert_allclose(shown.amplitude, depth.amplitude, rtol=1e-6)
            assert depth.mask.any()


def test_a_frame_costs_no_copies_and_no_buffers_but_its_own(frames, device, monkeypatch):
    copied: list[int] = []
    buffers = 0
    copy, make = pyopencl.enqueue_copy, pyopencl.Buffer

    def counted(queue: Any, to: Any, of: Any) -> Any:
        copied.append(next(a.nbytes for a in (to, of) if isinstance(a, np.ndarray)))
        return copy(queue, to, of)

    def made(*args: Any, **options: Any) -> Any:
        nonlocal buffers
        buffers += 1
        return make(*args, **options)

    with FrameImager(THIN, SWEEP, GRID, device=device) as imager:
        imager.form(frames[0])
        imager.depth_map()
        monkeypatch.setattr(pyopencl, "enqueue_copy", counted)
        monkeypatch.setattr(pyopencl, "Buffer", made)
        imager.form(frames[1])
        # The samples are read where they are, through one buffer of their memory.
        on_cpu = device.info.kind == "cpu"
        assert (copied, buffers) == (([], 1) if on_cpu else ([frames[1].data.nbytes], 0))
        copied.clear()
        imager.depth_map()
        padded = -(-GRID.counts[0] * GRID.counts[1] // device.width) * device.width
        assert sorted(copied) == [4 * padded, 24 * padded]
        copied.clear()
        assert imager.volume().data.nbytes == copied[0]
        assert len(copied) == 1
        assert buffers == on_cpu


def test_what_does_not_fit_is_refused(frames):
    with FrameImager(THIN, SWEEP, GRID) as imager:
        with pytest.raises(ModelError, match="a frame formed before"):
            imager.depth_map()
        other = THIN.part(slice(8), slice(None))
        with pytest.raises(ModelError, match="one by its array and waveform"):
            imager.form(noise(other, SWEEP))
        imager.form(frames[0])
        # A refused frame leaves the last image.
        with pytest.raises(ModelError):
            imager.form(noise(other, SWEEP))
        assert imager.depth_map().mask.any()
        # Samples that are finite, but whose sums are not.
        huge = np.full(frames[0].data.shape, 3e38, np.complex64)
        imager.form(Capture(huge, THIN, SWEEP))
        for read in (imager.depth_map, imager.volume):
            with pytest.raises(ModelError, match="overflow"):
                read()
        imager.form(frames[1])
        assert imager.depth_map().mask.any()


def test_grids_of_several_pieces_are_kept_on_the_host(frames, monkeypatch):
    monkeypatch.setattr(fast, "TILE_VOXELS", 20_000)
    with FrameImager(THIN, SWEEP, GRID) as imager:
        imager.form(frames[0])
        alone = clradar.backproject(frames[0], GRID, check_grid=False)
        np.testing.assert_array_equal(imager.volume().data, alone.data)
        np.testing.assert_array_equal(imager.depth_map().depth_m, alone.depth_map().depth_m)


def test_a_simulation_is_imaged_where_it_is(device, monkeypatch):
    """The samples do not come to the host, and the image has the same bits."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.015)
    scene = clradar.Scene.from_mesh(ball.apply_translation([0, 0.01, 0.29]), alpha=0.5)
    for estimator in ("expected", "physical"):
        options = {"samples_per_mm2": 2, "estimator": estimator, "seed": 1}
        with FrameImager(THIN, SWEEP, GRID, device=device) as imager:
            imager.form(clradar.simulate(scene, THIN, SWEEP, device=device, **options))
            want = imager.volume()
            if estimator != "physical":
                monkeypatch.setattr(PhasorSum, "result", _not_read)
            clradar.simulate_image(scene, imager, **options)
            monkeypatch.undo()
            monkeypatch.setattr(fast, "FEW_TERMS", 0)
            np.testing.assert_array_equal(imager.volume().data, want.data)
            assert imager.volume().meta == want.meta


def _not_read(self: PhasorSum) -> None:
    pytest.fail("the samples were read")


def test_the_absolute_scale_is_that_of_the_captures_gains(frames, device):
    louder = clradar.AntennaArray(
        THIN.tx_m, THIN.rx_m, tx_pattern=clradar.AntennaPattern(gain_dbi=6.0)
    )
    meta = {**frames[0].meta, "absolute": True}
    frame = Capture(frames[0].data, louder, SWEEP, meta)
    with FrameImager(THIN, SWEEP, GRID, device=device) as imager:
        imager.form(frame)
        alone = clradar.backproject(frame, GRID, check_grid=False, device=device)
        np.testing.assert_array_equal(imager.volume().rcs_dbsm(), alone.rcs_dbsm())

"""From a posed hand to its radar image: capture, image, depth map and a figure in ten lines."""

from __future__ import annotations

import clradar
from clradar.hand import hand_mesh
from clradar.plot import image_figure, save_figure


def main(samples_per_mm2: float = 2.0, spacing_m: float = 2e-3) -> None:
    # Ten samples per mm^2 and 1 mm voxels are the paper's; these take seconds.
    scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=0.3)
    array = clradar.arrays.qar50()
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    capture = clradar.simulate(scene, array, waveform, samples_per_mm2=samples_per_mm2, seed=0)
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), spacing_m)
    volume = clradar.backproject(capture, grid)
    depth = volume.depth_map(dynamic_range_db=15)
    save_figure(image_figure(depth, "Letter F, alpha = 0.3"), "hand.png", force=True)

    points_m = depth.points_m()
    print(f"receptions: {capture.meta['rays']['paths']}")
    print(f"pixels within 15 dB: {len(points_m)}")
    print(f"mean depth: {1e3 * points_m[:, 2].mean():.1f} mm")


if __name__ == "__main__":
    main()

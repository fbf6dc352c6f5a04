"""Which alpha fits a measurement best? Here the measurement is simulated, with alpha 0.3."""

from __future__ import annotations

import clradar
from clradar.hand import hand_mesh
from clradar.plot import comparison_figure, save_figure


def image(scene: clradar.Scene, alpha: float, seed: int, samples_per_mm2: float) -> clradar.Volume:
    capture = clradar.simulate(
        scene.with_alpha(alpha),
        clradar.arrays.qar50(),
        clradar.Waveform.sfcw(72e9, 82e9, 128),
        estimator="expected",
        samples_per_mm2=samples_per_mm2,
        seed=seed,
    )
    grid = clradar.VoxelGrid.from_extent((-0.08, 0.08), (-0.12, 0.12), (0.25, 0.35), 4e-3)
    return clradar.backproject(capture, grid)


def main(alphas: tuple[float, ...] = (0.0, 0.3, 0.9), samples_per_mm2: float = 1.0) -> None:
    scene = clradar.Scene.from_mesh(hand_mesh("F"))
    # For a real one: clradar.backproject(measurement_io.open_capture("000000.npy"), grid)
    measured = image(scene, 0.3, 1, samples_per_mm2)
    simulated = [(f"alpha = {a:g}", image(scene, a, 0, samples_per_mm2)) for a in alphas]
    metrics = [clradar.compare(measured, volume) for _, volume in simulated]
    for (label, _), m in zip(simulated, metrics, strict=True):
        print(f"{label}: overlap {m.overlap:.3f}, correlation {m.db_correlation:.3f}")
    best = max(range(len(alphas)), key=lambda i: metrics[i].overlap)
    print(f"best: {simulated[best][0]}")
    figure = comparison_figure(measured, simulated, metrics=metrics)
    save_figure(figure, "compare_alpha.png", force=True)


if __name__ == "__main__":
    main()

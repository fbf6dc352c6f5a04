"""From a recording and a mesh to one page that compares measurement and simulation."""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import trimesh

import clradar
from calibration import register
from clradar.hand import hand_mesh
from clradar.report import ReportImage, html_report
from measurement_io import open_recording, save_recording

GRID = clradar.VoxelGrid.from_extent((-0.08, 0.08), (-0.1, 0.1), (0.27, 0.33), 2e-3)


def make_recording(folder: Path) -> None:
    """Write a recording of a noisy hand, and its mesh."""
    hand = hand_mesh("F", edge_length_m=3e-3)
    scene = clradar.Scene.from_mesh(hand, alpha=0.2)
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 64)
    clean = clradar.simulate(scene, array, waveform, samples_per_mm2=1, seed=1)
    frame = clradar.impair(clean, snr_db=20, seed=1)
    # A recording's own space is mirrored, and its mesh is never quite where the hand was.
    mirrored = trimesh.Trimesh(hand.vertices_m * (-1, 1, 1), hand.faces[:, ::-1])
    place = [[1, 0, 0, -0.004], [0, 1, 0, 0.003], [0, 0, 1, 0], [0, 0, 0, 1]]
    alignment = {"photogrammetry2radar": place}
    with TemporaryDirectory() as made:
        mirrored.export(mesh := f"{made}/mesh.obj")
        save_recording(folder, [frame], alignment=alignment, meshes=[mesh])


def main(recording: Path | None, mesh: Path | None, alpha: float, page: Path) -> None:
    if recording is None and not (recording := Path("noisy_hand/30")).exists():
        make_recording(recording)
    frames = open_recording(recording)
    # A mesh of one's own is in the antenna frame, metres; the recording's is brought there.
    scene = (clradar.Scene.from_mesh(mesh) if mesh else frames.scene()).with_alpha(alpha)

    radar = {"array": frames.array, "waveform": frames.waveform}
    measured = clradar.backproject(frames[0], GRID)
    given = clradar.backproject(clradar.simulate(scene, **radar, samples_per_mm2=1), GRID)
    # Places the mesh, simulates it there, and repeats until it no longer moves.
    placed = register(measured, scene, **radar, samples_per_mm2=1, max_rounds=5)
    simulated = [ReportImage("As given", given), ReportImage("Registered", placed.volume)]
    first = ReportImage("Measurement", measured, str(frames.path))
    notes = [placed.alignment.report()]
    page.write_text(html_report(first, simulated, notes=notes), encoding="utf-8")
    print(f"shift: {', '.join(f'{1e3 * v:.1f}' for v in placed.alignment.shift_m)} mm")
    for s in simulated:
        print(f"{s.label}: overlap {clradar.compare(measured, s.image).overlap:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", nargs="?", type=Path, help="a folder; without it one is made")
    parser.add_argument("--mesh", type=Path, help="instead of the recording's own")
    parser.add_argument("--alpha", type=float, default=0.2, help="0 specular ... 1 diffuse")
    parser.add_argument("--page", type=Path, default="report.html", help="page to write")
    main(**vars(parser.parse_args()))

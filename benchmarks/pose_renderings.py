"""Draw every packaged pose from the radar's side and from a slant: docs/images/poses.png.

python benchmarks/pose_renderings.py -o docs/images/poses.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from clradar.hand import POSES, HandMesh, hand_mesh

EDGE_M = 2e-3
PIXEL_M = 1.5e-3
TILE_PIXELS = 150
COLUMNS = 6
COLOURS = 200  # of the palette; keeps the file small

LIGHT = np.array([0.35, 0.55, -0.75]) / np.linalg.norm([0.35, 0.55, -0.75])
# Palm, thumb, index, middle, ring, pinky.
SKIN = np.array([[0.93, 0.80, 0.72], [0.95, 0.60, 0.55], [0.60, 0.80, 0.95],
                 [0.65, 0.90, 0.65], [0.95, 0.88, 0.55], [0.82, 0.70, 0.95]])  # fmt: skip


def rotation(axis: int, angle_deg: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) about a coordinate axis."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    after, last = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[after, after] = matrix[last, last] = c
    matrix[after, last], matrix[last, after] = -s, s
    return matrix


VIEWS = (np.eye(3), rotation(0, -15.0) @ rotation(1, 50.0))


def rendering(mesh: HandMesh, view: np.ndarray) -> np.ndarray:
    """Return a shaded rendering (TILE_PIXELS, TILE_PIXELS, 3), uint8, along +z, +x to the left.

    Faces are filled with points, of which each pixel shows the nearest.
    """
    centre_m = 0.5 * (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0))
    corners_m = ((mesh.vertices_m - centre_m) @ view.T)[mesh.faces]
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    towards = normal[:, 2] < 0.0
    shade = 0.25 + 0.75 * np.clip(normal[towards] @ LIGHT, 0.0, 1.0)
    colour = SKIN[mesh.part[towards]] * shade[:, None]
    a, b, c = np.moveaxis(corners_m[towards], 1, 0)
    weights = [(i / 5, j / 5) for i in range(6) for j in range(6 - i)]
    points_m = np.concatenate([a * (1 - u - v) + b * u + c * v for u, v in weights])
    colours = np.tile(colour, (len(weights), 1))
    at = np.round(0.5 * TILE_PIXELS - points_m[:, :2] / PIXEL_M).astype(int)
    far_first = np.argsort(-points_m[:, 2])
    image = np.ones((TILE_PIXELS, TILE_PIXELS, 3))
    image[at[far_first, 1], at[far_first, 0]] = colours[far_first]
    return (image * 255).astype(np.uint8)


def tile(name: str) -> np.ndarray:
    """Return all views of a pose beside each other, with its name."""
    mesh = hand_mesh(name, EDGE_M)
    image = Image.fromarray(np.concatenate([rendering(mesh, view) for view in VIEWS], axis=1))
    ImageDraw.Draw(image).text((4, 4), name, fill=(0, 0, 0))
    return np.array(image)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output
    tiles = [tile(name) for name in POSES]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.concatenate(tiles[i : i + COLUMNS], axis=1) for i in range(0, len(tiles), COLUMNS)]
    Image.fromarray(np.concatenate(rows)).quantize(COLOURS).save(output, optimize=True)


if __name__ == "__main__":
    main()

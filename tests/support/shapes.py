"""Small meshes for the tests: vertices, shape (n, 3), metres, and faces, shape (m, 3)."""

import numpy as np
import trimesh

Mesh = tuple[np.ndarray, np.ndarray]


def plate(
    size_m: float, z_m: float, cells: int = 1, wavy_m: float = 0.0, inverted: bool = False
) -> Mesh:
    """Square in a plane of constant z, or waves of amplitude `wavy_m` around it."""
    axis = np.linspace(-size_m / 2, size_m / 2, cells + 1)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    wave = np.sin(2 * np.pi * x / size_m * 2) * np.cos(2 * np.pi * y / size_m)
    vertices = np.stack([x, y, z_m + wavy_m * wave], axis=1)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    low = np.stack([corner, corner + 1, corner + cells + 2], axis=1)
    high = np.stack([corner, corner + cells + 2, corner + cells + 1], axis=1)
    faces = np.concatenate([low, high])
    return vertices, faces[:, ::-1] if inverted else faces


def box(centre_m: tuple[float, float, float], size_m: tuple[float, float, float]) -> Mesh:
    """Closed box of twelve triangles."""
    mesh = trimesh.creation.box(extents=size_m)
    return np.asarray(mesh.vertices) + np.asarray(centre_m), np.asarray(mesh.faces)


def sphere(centre_m: tuple[float, float, float], radius_m: float, subdivisions: int) -> Mesh:
    """Icosphere."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m)
    return np.asarray(mesh.vertices) + np.asarray(centre_m), np.asarray(mesh.faces)


def dihedral(size_m: float, apex_z_m: float) -> Mesh:
    """Two squares at a right angle, open towards the radar, their common edge along y."""
    h, b = size_m / np.sqrt(2), size_m / 2
    x, y = np.array([0, 0, -h, -h, h, h]), np.array([-b, b, -b, b, -b, b])
    vertices = np.stack([x, y, apex_z_m - np.abs(x)], axis=1)
    return vertices, np.array([[0, 1, 2], [1, 3, 2], [0, 4, 1], [1, 4, 5]])


def random_soup(rng: np.random.Generator, n_faces: int, size_m: float) -> Mesh:
    """Triangles of all sizes and directions that pierce each other, in a cube at z = 0.3 m."""
    centre = rng.uniform(-0.1, 0.1, (n_faces, 1, 3)) + np.array([0.0, 0.0, 0.3])
    scale = size_m * 10 ** rng.uniform(-1.5, 0, (n_faces, 1, 1))
    corners = centre + scale * rng.normal(size=(n_faces, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * n_faces).reshape(-1, 3)


def bowl(rings: int = 8, sectors: int = 16) -> Mesh:
    """Open half sphere of 8 cm radius, its inside towards the radar: concave everywhere."""
    tilt, azimuth = np.linspace(0.05, np.pi / 2, rings), np.arange(sectors) * 2 * np.pi / sectors
    t, p = np.meshgrid(tilt, azimuth, indexing="ij")
    vertices = 0.08 * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=2)
    faces = []
    for i in range(rings - 1):
        for j in range(sectors):
            a, b = i * sectors + j, i * sectors + (j + 1) % sectors
            faces += [[a, b, b + sectors], [a, b + sectors, a + sectors]]
    return vertices.reshape(-1, 3) + np.array([0.0, 0.0, 0.3]), np.array(faces)


def with_degenerate(rng: np.random.Generator, mesh: Mesh) -> Mesh:
    """Add to a mesh: repeated faces, points, needles without area, and slivers."""
    vertices, faces = mesh
    n = len(vertices)
    pick = rng.choice(len(faces), 5)
    point = np.repeat(rng.integers(0, n, 5), 3).reshape(-1, 3)
    line = rng.integers(0, n, (5, 2))[:, [0, 1, 1]]
    start, end = vertices[faces[pick, 0]], vertices[faces[pick, 1]]
    middle = (start + end) / 2  # collinear up to rounding
    nearly = (start + end) / 2 + 1e-5 * rng.normal(size=start.shape)
    more = np.concatenate([middle, nearly])
    needle = np.stack([faces[pick, 0], faces[pick, 1], n + np.arange(5)], axis=1)
    sliver = np.stack([faces[pick, 0], faces[pick, 1], n + 5 + np.arange(5)], axis=1)
    return (
        np.concatenate([vertices, more]),
        np.concatenate([faces, faces[pick], faces[pick][:, ::-1], point, line, needle, sliver]),
    )

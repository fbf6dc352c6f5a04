"""The hand's surface: marching cubes on the flesh, placed in front of the radar."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.errors import ModelError
from clradar.hand.crossings import crossing_faces
from clradar.hand.flesh import (
    PART_NAMES,
    Flesh,
    Neighbourhoods,
    grown_flesh,
    neighbourhoods,
    unit_vectors,
)
from clradar.hand.joints import JOINT_NAMES
from clradar.hand.known_poses import pose_by_name
from clradar.hand.pose import HandPose
from clradar.hand.shape import AVERAGE, HandShape
from clradar.hand.skeleton import posed_skeleton
from clradar.model import checks

if TYPE_CHECKING:
    import trimesh

DEFAULT_EDGE_LENGTH_M = 1.7e-3
"""About 41 000 faces; the mean edge, 1.6 mm, is below half a wavelength at 82 GHz (1.8 mm)."""

DEFAULT_CENTER_M = (0.0, 0.0, 0.300)

# Finer would need gigabytes, coarser would lose the gaps between the fingers.
_EDGE_LIMITS_M = (0.5e-3, 4e-3)

_HANDEDNESS = ("right", "left")

# Fine nodes per coarse cell: one in _COARSE**3 nodes is sampled to find where the surface can be.
_COARSE = 4


@dataclass(frozen=True, slots=True, eq=False)
class HandMesh:
    """A closed triangle mesh of a hand, with its joints.

    Parameters
    ----------
    vertices_m : array_like, shape (V, 3), float64, metres
        Vertices in the antenna frame.
    faces : array_like, shape (F, 3), int32
        Vertex indices, counter-clockwise seen from outside.
    joints_m : array_like, shape (25, 3), float64, metres
        Joint centres in the antenna frame, in the order of `JOINT_NAMES`; NaN for a joint that a
        rig of one's own does not have.
    part : array_like, shape (F,), int32
        For each face, the index into `part_names` of the part it belongs to.
    part_names : tuple of str
        Names of the parts: palm, thumb, index, middle, ring, pinky.
    """

    vertices_m: np.ndarray
    faces: np.ndarray
    joints_m: np.ndarray
    part: np.ndarray
    part_names: tuple[str, ...] = PART_NAMES

    def __post_init__(self) -> None:
        vertices_m = checks.read_only("HandMesh.vertices_m", self.vertices_m, np.float64, (None, 3))
        faces = checks.read_only("HandMesh.faces", self.faces, np.int32, (None, 3))
        if faces.min() < 0 or faces.max() >= len(vertices_m):
            checks.fail(
                "HandMesh.faces",
                f"indices in [0, {len(vertices_m) - 1}]",
                f"[{faces.min()}, {faces.max()}]",
            )
        joints_m = checks.read_only(
            "HandMesh.joints_m", self.joints_m, np.float64, (len(JOINT_NAMES), 3), finite=False
        )
        part_names = tuple(checks.text("HandMesh.part_names", n) for n in self.part_names)
        part = checks.read_only("HandMesh.part", self.part, np.int32, (len(faces),))
        if part.min() < 0 or part.max() >= len(part_names):
            checks.fail(
                "HandMesh.part",
                f"indices in [0, {len(part_names) - 1}]",
                f"[{part.min()}, {part.max()}]",
            )
        for name, value in (
            ("vertices_m", vertices_m),
            ("faces", faces),
            ("joints_m", joints_m),
            ("part", part),
            ("part_names", part_names),
        ):
            object.__setattr__(self, name, value)

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return the surface as a `trimesh.Trimesh` in metres, vertices and faces in this order."""
        import trimesh

        return trimesh.Trimesh(
            vertices=np.array(self.vertices_m), faces=np.array(self.faces), process=False
        )


def hand_joints(
    pose: str | HandPose = "F",
    handedness: str = "right",
    center_m: Any = DEFAULT_CENTER_M,
    shape: HandShape = AVERAGE,
) -> np.ndarray:
    """Return the joints of a hand that stands in front of the radar, palm towards it.

    Parameters
    ----------
    pose : str or HandPose
        A name in `POSES`, upper or lower case, or a pose of one's own.
    handedness : {"right", "left"}
        A right hand's thumb points to -x, a left hand is its mirror image.
    center_m : array_like, shape (3,), metres
        Where the centre of the flesh's bounding box goes, in the antenna frame.
    shape : HandShape

    Returns
    -------
    ndarray, shape (25, 3), float64, metres
        Joint centres in the order of `JOINT_NAMES`: those of `hand_mesh` with the default edge
        length. Another edge length moves the box's centre, and so the joints, by up to 0.2 mm.
    """
    return hand_mesh(pose, handedness=handedness, center_m=center_m, shape=shape).joints_m


def hand_mesh(
    pose: str | HandPose = "F",
    edge_length_m: float = DEFAULT_EDGE_LENGTH_M,
    handedness: str = "right",
    center_m: Any = DEFAULT_CENTER_M,
    shape: HandShape = AVERAGE,
) -> HandMesh:
    """Return the closed surface of a hand that stands in front of the radar, palm towards it.

    Parameters
    ----------
    pose : str or HandPose
        A name in `POSES`, upper or lower case, or a pose of one's own.
    edge_length_m : float, metres
        Spacing of the sampling grid, in [0.5, 4] mm; the triangles' edges are 0.95 of it in the
        mean and at most 1.6 of it.
    handedness : {"right", "left"}
        A right hand's thumb points to -x, a left hand is its mirror image.
    center_m : array_like, shape (3,), metres
        Where the centre of the surface's bounding box goes, in the antenna frame.
    shape : HandShape
        Length, breadth, finger lengths, girth; an average adult's by default.

    Returns
    -------
    HandMesh

    Raises
    ------
    ModelError
        If an argument cannot be meant.
    """
    posed = pose if isinstance(pose, HandPose) else pose_by_name(pose)
    spacing_m = checks.positive("edge_length_m", edge_length_m)
    low_m, high_m = _EDGE_LIMITS_M
    if not low_m <= spacing_m <= high_m:
        checks.fail("edge_length_m", f"a length in [{low_m:g}, {high_m:g}] m", f"{spacing_m:g} m")
    checks.one_of("handedness", handedness, _HANDEDNESS)
    centre_m = checks.read_only("center_m", center_m, np.float64, (3,))
    checks.instance("shape", shape, HandShape)

    vertices_m, faces, joints_m, part = _right_hand(posed, spacing_m, shape)
    if handedness == "left":
        mirror = np.array([-1.0, 1.0, 1.0])
        # A mirror image turns every triangle inside out; exchanging two corners turns it back.
        vertices_m, joints_m, faces = vertices_m * mirror, joints_m * mirror, faces[:, [0, 2, 1]]
    return HandMesh(vertices_m + centre_m, faces, joints_m + centre_m, part)


@lru_cache(maxsize=4)
def _right_hand(
    pose: HandPose, spacing_m: float, shape: HandShape = AVERAGE
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, faces, joints and parts of a right hand with its box around the origin."""
    # Sampled before the wrist turns it: the same fingers get the same triangles however the hand is
    # held, in the smallest box.
    unturned = replace(pose, joints={j: a for j, a in pose.joints.items() if j != "wrist"})
    bones, turned = posed_skeleton(unturned, shape), posed_skeleton(pose, shape)
    flesh = grown_flesh(bones)
    vertices_m, faces, near = _surface(flesh, spacing_m)
    part = flesh.nearest_part(vertices_m[faces].mean(axis=1), near)
    vertices_m = vertices_m @ turned.frames[0].T
    centre_m = 0.5 * (vertices_m.min(axis=0) + vertices_m.max(axis=0))
    result = (vertices_m - centre_m, faces, turned.joints_m - centre_m, part)
    for array in result:
        array.flags.writeable = False
    return result


def _surface(flesh: Flesh, spacing_m: float) -> tuple[np.ndarray, np.ndarray, Neighbourhoods]:
    """Return vertices (V, 3), metres, and faces (F, 3), int32, of the flesh's surface."""
    from skimage.measure import marching_cubes

    distance_m, near = _sampled(flesh, spacing_m)
    # In units of the spacing: marching cubes works in single precision with absolute tolerances.
    raw, faces, _, _ = marching_cubes(distance_m / spacing_m, 0.0, gradient_direction="descent")
    vertices_m = near.low_m + 0.5 * spacing_m + raw.astype(np.float64) * spacing_m
    vertices_m, faces = _largest_component(vertices_m, faces.astype(np.int64))
    vertices_m = _relaxed(flesh, vertices_m, faces, near, spacing_m)
    if not _is_closed(faces):
        raise ModelError("pose: expected one closed surface, got one with open edges")
    return vertices_m, faces.astype(np.int32), near


def _sampled(flesh: Flesh, spacing_m: float) -> tuple[np.ndarray, Neighbourhoods]:
    """Return signed distances on a grid (n_x, n_y, n_z), and the cells of its nodes.

    The nodes are half a spacing inside their cells, _COARSE along each axis. A distance never
    overestimates, so a cell whose centre is farther from the surface than its corners are from the
    centre holds no surface, and its nodes need only a sign.
    """
    cell_m = _COARSE * spacing_m
    low_m, high_m = flesh.bounds_m()
    # The first node is a spacing outside.
    low_m, high_m = low_m - spacing_m, high_m + spacing_m
    n_cells = np.ceil((high_m - low_m) / cell_m).astype(int)
    shape = (int(n_cells[0]), int(n_cells[1]), int(n_cells[2]))
    near = neighbourhoods(flesh, low_m - 0.5 * spacing_m, cell_m, shape)
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    cells = cells.reshape(-1, 3)
    coarse_m = flesh.distance_m(near.low_m + (cells + 0.5) * cell_m, near)
    # Nodes one step outside the cell count too: the surface may run between two cells.
    crossed = np.abs(coarse_m) <= 0.5 * (_COARSE + 1) * np.sqrt(3.0) * spacing_m
    blocks = np.broadcast_to(
        coarse_m.reshape(shape)[:, None, :, None, :, None],
        (shape[0], _COARSE, shape[1], _COARSE, shape[2], _COARSE),
    )
    distance_m = np.ascontiguousarray(blocks).reshape(tuple(n_cells * _COARSE))
    inner = np.stack(np.meshgrid(*(np.arange(_COARSE),) * 3, indexing="ij"), axis=-1)
    nodes = (cells[crossed][:, None, :] * _COARSE + inner.reshape(1, -1, 3)).reshape(-1, 3)
    distance_m[tuple(nodes.T)] = flesh.distance_m(low_m + nodes * spacing_m, near)
    return distance_m, near


def _largest_component(vertices_m: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the connected surface with the most faces, without unused vertices."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = len(vertices_m)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    links = coo_matrix((np.ones(len(ends), dtype=bool), tuple(ends.T)), shape=(n, n))
    _, label = connected_components(links, directed=False)
    keep = label[faces[:, 0]] == np.argmax(np.bincount(label[faces[:, 0]]))
    used, renumbered = np.unique(faces[keep], return_inverse=True)
    return vertices_m[used], renumbered.reshape(-1, 3)


def _relaxed(
    flesh: Flesh, raw_m: np.ndarray, faces: np.ndarray, near: Neighbourhoods, spacing_m: float
) -> np.ndarray:
    """Return vertices moved along the surface to even out the triangles, and onto the surface.

    Marching cubes leaves slivers where the surface passes close to a grid node; moving each vertex
    half-way to the mean of its neighbours, in the tangent plane only, opens them.
    """
    from scipy.sparse import coo_matrix

    n = len(raw_m)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    # Every edge of a closed surface belongs to two faces, once in each direction.
    links = coo_matrix((np.ones(len(ends)), tuple(ends.T)), shape=(n, n)).tocsr()
    weight = np.asarray(links.sum(axis=1))
    vertices_m = raw_m
    for _ in range(2):
        normal = unit_vectors(flesh.slope(vertices_m, near)[1])
        step_m = 0.5 * (links @ vertices_m / weight.reshape(-1, 1) - vertices_m)
        step_m -= normal * np.einsum("ij,ij->i", step_m, normal)[:, None]
        vertices_m = vertices_m + step_m
        vertices_m = vertices_m - normal * flesh.distance_m(vertices_m, near)[:, None]
    return _uncrossed(vertices_m, raw_m, faces, _facing(flesh, vertices_m, normal, near, spacing_m))


def _facing(
    flesh: Flesh,
    vertices_m: np.ndarray,
    normal: np.ndarray,
    near: Neighbourhoods,
    spacing_m: float,
) -> np.ndarray:
    """Return which vertices (V,) have skin in front of them, as where fingers touch."""
    ahead_m = 2.0 * spacing_m
    return flesh.distance_m(vertices_m + ahead_m * normal, near) < 0.9 * ahead_m


def _uncrossed(
    vertices_m: np.ndarray, raw_m: np.ndarray, faces: np.ndarray, facing: np.ndarray
) -> np.ndarray:
    """Return the vertices, those of faces that cross others back where marching cubes had them.

    Its triangles stay in their cells, where they may touch but not cross.
    """
    vertices_m = vertices_m.copy()
    among = np.flatnonzero(facing[faces].any(axis=1))
    back = np.zeros(len(vertices_m), dtype=bool)
    while len(crossed := crossing_faces(vertices_m, faces, among)):
        corners = faces[np.unique(crossed)]
        if back[corners].all():
            break
        back[corners] = True
        vertices_m[back] = raw_m[back]
    return vertices_m


def _is_closed(faces: np.ndarray) -> bool:
    """Return whether every edge occurs exactly once in each direction."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = int(faces.max()) + 1
    forward, backward = ends[:, 0] * n + ends[:, 1], ends[:, 1] * n + ends[:, 0]
    unique = np.unique(forward)
    return len(unique) == len(forward) and np.array_equal(unique, np.unique(backward))

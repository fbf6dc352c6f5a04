"""The hand's surface: marching cubes on the signed distance field, placed in front of the radar.

Lorensen and Cline, "Marching cubes: a high resolution 3D surface construction algorithm", SIGGRAPH
1987, in the variant of scikit-image; then two steps of tangential Laplacian relaxation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from clradar.errors import ModelError
from clradar.hand.flesh import PART_NAMES, FleshField, grown_flesh
from clradar.hand.joints import JOINT_NAMES
from clradar.hand.pose import HandPose
from clradar.hand.pose_file import pose_by_name
from clradar.hand.shape import AVERAGE, HandShape
from clradar.hand.skeleton import posed_skeleton
from clradar.hand.skin import Skin, skin_weights
from clradar.model import checks
from clradar.model.plausible import place
from clradar.model.record import Record
from clradar.opencl import Buffers, Device, open_device

if TYPE_CHECKING:
    import trimesh
    from scipy.sparse import csr_array

DEFAULT_EDGE_LENGTH_M = 1.7e-3
"""About 41 000 faces; the mean edge, 1.6 mm, is below half a wavelength at 82 GHz (1.8 mm)."""

DEFAULT_CENTER_M = (0.0, 0.0, 0.300)

# Finer would need gigabytes, coarser would lose the gaps between the fingers.
_EDGE_LIMITS_M = (0.5e-3, 4e-3)

_COARSE_M = 4e-3  # spacing of the cells of a field that is asked at points only

# An edge whose sine to a triangle's plane is less lies in it: coplanar triangles do not cross.
_LEAST_SLOPE = 1e-7


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HandMesh(Record):
    """A closed triangle mesh of a hand, with its joints, in the antenna frame.

    Parameters
    ----------
    vertices_m : array_like, shape (V, 3)
    faces : array_like, shape (F, 3), int32
        Vertex indices, counter-clockwise seen from outside.
    joints_m : array_like, shape (25, 3)
        Joint centres in the order of `JOINT_NAMES`; NaN for one that a rig does not have.
    part : array_like, shape (F,), int32
        For each face, the index into `part_names`: palm, thumb, index, middle, ring, pinky.
    normals : array_like, shape (V, 3), optional
        Outward unit normals of the implicit surface; None for a rig.
    texture_m : array_like, shape (V, 3), optional
        Where each vertex is in the flat right hand, or in the rig at rest: coordinates in which the
        skin's roughness is defined. None: `vertices_m`.
    """

    vertices_m: np.ndarray
    faces: np.ndarray
    joints_m: np.ndarray
    part: np.ndarray
    normals: np.ndarray | None = None
    texture_m: np.ndarray | None = None
    part_names: ClassVar[tuple[str, ...]] = PART_NAMES

    def __post_init__(self) -> None:
        vertices_m = self._set_array("vertices_m", np.float64, (None, 3))
        faces = self._set_array("faces", np.int32, (None, 3))
        self._set_array("joints_m", np.float64, (len(JOINT_NAMES), 3), finite=False)
        part = self._set_array("part", np.int32, (len(faces),))
        for name in ("normals", "texture_m"):
            if getattr(self, name) is not None:
                self._set_array(name, np.float64, vertices_m.shape)
        checks.indices("HandMesh.faces", faces, len(vertices_m))
        checks.indices("HandMesh.part", part, len(PART_NAMES))

    def moved(self, matrix: np.ndarray, shift_m: np.ndarray) -> HandMesh:
        """The mesh turned or mirrored by an orthogonal matrix (3, 3), then shifted."""
        return replace(
            self,
            vertices_m=_rotated(self.vertices_m, matrix) + shift_m,
            joints_m=_rotated(self.joints_m, matrix) + shift_m,
            # A mirror image reverses the winding; exchanging two corners restores it.
            faces=self.faces if np.linalg.det(matrix) > 0 else self.faces[:, [0, 2, 1]],
            normals=None if self.normals is None else _rotated(self.normals, matrix),
            texture_m=self.vertices_m if self.texture_m is None else self.texture_m,
        )

    def to_trimesh(self) -> trimesh.Trimesh:
        """The surface as a `trimesh.Trimesh` in metres."""
        import trimesh

        return trimesh.Trimesh(np.array(self.vertices_m), np.array(self.faces), process=False)


def _rotated(vectors: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    # Written out: the bits of a matrix product may depend on the number of threads of BLAS.
    x, y, z = vectors.T
    return np.stack([m[0] * x + m[1] * y + m[2] * z for m in matrix], axis=1)


def checked_edge_m(edge_length_m: float) -> float:
    """Return the length of edges of a hand's mesh; raise `ModelError` where it makes none."""
    return checks.within("edge_length_m", edge_length_m, *_EDGE_LIMITS_M, " m")


def hand_mesh(
    pose: str | HandPose = "F",
    edge_length_m: float = DEFAULT_EDGE_LENGTH_M,
    handedness: str = "right",
    center_m: Any = DEFAULT_CENTER_M,
    shape: HandShape = AVERAGE,
    device: Device | str | None = None,
) -> HandMesh:
    """Return the closed surface of a hand that stands in front of the radar, palm towards it.

    Parameters
    ----------
    pose : str or HandPose
        A name in `POSES`, or a pose.
    edge_length_m : float
        Spacing of the sampling grid, 0.5 to 4 mm; the triangles' edges are 0.95 of it in the mean
        and at most 1.6 of it.
    handedness : {"right", "left"}
        A right hand's thumb points to -x, a left hand is its mirror image.
    center_m : array_like, shape (3,)
        Where the centre of the surface's bounding box goes.
    shape : HandShape

    Returns
    -------
    HandMesh
        On the same device and driver the same bits.

    Examples
    --------
    >>> mesh = clradar.hand.hand_mesh("L", 4e-3, handedness="left", center_m=(0, 0, 0.25))
    >>> size_m = mesh.vertices_m.max(axis=0) - mesh.vertices_m.min(axis=0)
    >>> [round(100 * length_m) for length_m in size_m.tolist()]  # centimetres
    [17, 18, 7]
    """
    posed = pose if isinstance(pose, HandPose) else pose_by_name(pose)
    spacing_m = checked_edge_m(edge_length_m)
    checks.one_of("handedness", handedness, ("right", "left"))
    centre_m = place("center_m", center_m)
    checks.instance("shape", shape, HandShape)

    # Sampled before the wrist rotates it: the same fingers get the same triangles for every angle
    # of the wrist, in the smallest box.
    bones = posed_skeleton(_with_straight_wrist(posed), shape)
    rotated = posed_skeleton(posed, shape)
    with Buffers(open_device(device)) as buffers:
        field = FleshField(grown_flesh(bones), spacing_m, buffers)
        vertices_m, faces = _surface(field, spacing_m)
        part = field.nearest_parts(vertices_m[faces].mean(axis=1))
        normals = _unit_vectors(field.gradients(vertices_m))
    # Where the skin is on the flat hand of the same bones, wrist straight.
    flat = posed_skeleton(_with_straight_wrist(pose_by_name("flat")), shape)
    skin = Skin.on(vertices_m, skin_weights(vertices_m, normals, bones), bones)
    texture_m = skin.posed(flat.frames, flat.joints_m)
    vertices_m = vertices_m @ rotated.frames[0].T
    normals = normals @ rotated.frames[0].T
    middle_m = 0.5 * (vertices_m.min(axis=0) + vertices_m.max(axis=0))
    own = vertices_m - middle_m, faces, rotated.joints_m - middle_m, part
    right = HandMesh(*own, normals=normals, texture_m=texture_m)
    return right.moved(np.diag([-1.0 if handedness == "left" else 1.0, 1.0, 1.0]), centre_m)


def kept_from_skin(
    vertices_m: np.ndarray,
    away_m: np.ndarray | None,
    pose: HandPose,
    shape: HandShape = AVERAGE,
    device: Device | str | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bring points near the skin of a right hand to their distances from it, by two Newton steps.

    Points (V, 3), metres, are in the frame of `posed_skeleton`; distances are negative inside,
    None: they stay. Returns points, unit normals of the field there (V, 3), and distances (V,)
    before.
    """
    straight = _with_straight_wrist(pose)
    turn = posed_skeleton(pose, shape).frames[0]
    at_m = vertices_m @ turn
    with Buffers(open_device(device)) as buffers:
        field = FleshField(grown_flesh(posed_skeleton(straight, shape)), _COARSE_M, buffers)
        before_m = field.distances_m(at_m).astype(np.float64)
        steps, wanted_m = (0, before_m) if away_m is None else (2, away_m)
        for _ in range(steps):
            normal = _unit_vectors(field.gradients(at_m))
            at_m = at_m - normal * (field.distances_m(at_m) - wanted_m)[:, None]
        normal = _unit_vectors(field.gradients(at_m))
    return at_m @ turn.T, normal @ turn.T, before_m


def _with_straight_wrist(pose: HandPose) -> HandPose:
    return replace(pose, joints={j: a for j, a in pose.joints.items() if j != "wrist"})


def _surface(field: FleshField, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3), metres, and faces (F, 3), int32, of the flesh's surface."""
    from skimage.measure import marching_cubes

    # In units of the spacing: marching cubes works in single precision with absolute tolerances.
    distance = field.node_distances_m() / np.float32(spacing_m)
    raw, faces, _, _ = marching_cubes(distance, 0.0, gradient_direction="descent")
    raw_m = field.first_m + raw.astype(np.float64) * spacing_m
    raw_m, faces, adjacency = _largest_component(raw_m, faces)
    # Every edge occurs once in each direction.
    if (adjacency.data != 1.0).any() or (adjacency != adjacency.T).nnz:
        raise ModelError("pose: expected one closed surface, got one with open edges")
    vertices_m, normal = _relaxed(field, raw_m, adjacency)
    # Which have other skin close in front, as where fingers touch.
    ahead_m = 2.0 * spacing_m
    facing = field.distances_m(vertices_m + ahead_m * normal) < 0.9 * ahead_m
    return _uncrossed(vertices_m, raw_m, faces, facing), faces


def _largest_component(
    vertices_m: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, csr_array]:
    """Return the component with the most faces, without unused vertices, and its adjacency."""
    from scipy.sparse.csgraph import connected_components

    adjacency = _adjacency(faces, len(vertices_m))
    count, label = connected_components(adjacency, directed=False)
    if count == 1:
        return vertices_m, faces, adjacency
    keep = label[faces[:, 0]] == np.argmax(np.bincount(label[faces[:, 0]]))
    used, own = np.unique(faces[keep], return_inverse=True)
    faces = own.reshape(-1, 3).astype(np.int32)
    return vertices_m[used], faces, _adjacency(faces, len(used))


def _adjacency(faces: np.ndarray, n: int) -> csr_array:
    """Return the adjacency matrix (n, n) of directed edges, with their counts, float64."""
    from scipy.sparse import coo_array

    begin = faces.T.reshape(-1)
    end = faces[:, [1, 2, 0]].T.reshape(-1)
    return coo_array((np.ones(len(begin)), (begin, end)), shape=(n, n)).tocsr()


def _relaxed(
    field: FleshField, vertices_m: np.ndarray, adjacency: csr_array
) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices after two steps of tangential Laplacian relaxation, and their normals (V, 3).

    Marching cubes leaves slivers where the surface passes close to a grid node: each vertex moves
    half-way to the mean of its neighbours, in the tangent plane, then back to the surface.
    """
    weight = adjacency.sum(axis=1).reshape(-1, 1)
    for _ in range(2):
        normal = _unit_vectors(field.gradients(vertices_m))
        step_m = 0.5 * (adjacency @ vertices_m / weight - vertices_m)
        step_m -= normal * np.einsum("ij,ij->i", step_m, normal)[:, None]
        vertices_m = vertices_m + step_m
        vertices_m = vertices_m - normal * field.distances_m(vertices_m)[:, None]
    return vertices_m, normal


def _unit_vectors(vectors: np.ndarray) -> np.ndarray:
    vectors = vectors.astype(np.float64)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)


def _uncrossed(
    vertices_m: np.ndarray,
    raw_m: np.ndarray,
    faces: np.ndarray,
    facing: np.ndarray,
) -> np.ndarray:
    """Return the vertices with those of intersecting faces where marching cubes had them.

    The triangles of marching cubes stay within their cells, so they cannot intersect.
    """
    vertices_m = vertices_m.copy()
    among = np.flatnonzero(facing[faces].any(axis=1))
    back = np.zeros(0, dtype=np.int32)
    while len(crossed := crossing_faces(vertices_m, faces, among)):
        moved = np.setdiff1d(faces[crossed], back)
        if not len(moved):
            break
        back = np.union1d(back, moved)
        vertices_m[moved] = raw_m[moved]
    return vertices_m


def crossing_faces(
    vertices_m: np.ndarray, faces: np.ndarray, among: np.ndarray | None = None
) -> np.ndarray:
    """Return the pairs (N, 2) of faces, of those `among`, without a common corner that intersect.

    Two triangles intersect if an edge of one meets the other, unless it lies in its plane.
    """
    chosen = np.arange(len(faces)) if among is None else among
    if not len(chosen):
        return np.zeros((0, 2), dtype=np.int64)
    corners = faces[chosen]
    triangles_m = vertices_m[corners]
    one, other = _close_pairs(triangles_m)
    apart = (corners[one][:, :, None] != corners[other][:, None, :]).all(axis=(1, 2))
    one, other = one[apart], other[apart]
    crossed = np.zeros(len(one), dtype=bool)
    for a, b in ((one, other), (other, one)):
        for k in range(3):
            begin_m, end_m = triangles_m[a, k], triangles_m[a, (k + 1) % 3]
            crossed |= _edge_meets(begin_m, end_m - begin_m, triangles_m[b])
    return chosen[np.stack([one[crossed], other[crossed]], axis=1)]


def _close_pairs(triangles_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of triangles (N, 3, 3) whose bounding boxes overlap, each pair once."""
    from scipy.spatial import cKDTree

    centre_m = (triangles_m[:, 0] + triangles_m[:, 1] + triangles_m[:, 2]) / 3.0
    from_m = triangles_m - centre_m[:, None]
    most_m = 2.0 * np.sqrt(np.einsum("ijk,ijk->ij", from_m, from_m).max()) * (1.0 + 1e-9)
    one, other = cKDTree(centre_m).query_pairs(most_m, output_type="ndarray").T
    for low_m, high_m in zip(triangles_m.min(axis=1).T, triangles_m.max(axis=1).T, strict=True):
        meet = (low_m[one] <= high_m[other]) & (low_m[other] <= high_m[one])
        one, other = one[meet], other[meet]
    return one, other


def _edge_meets(begin_m: np.ndarray, edge_m: np.ndarray, triangles_m: np.ndarray) -> np.ndarray:
    """Return for N edges and N triangles whether the edge meets the triangle.

    By signs: an edge's line passes all sides of a triangle that it meets in the same sense.
    """
    a, b, c = (triangles_m - begin_m[:, None]).swapaxes(0, 1)
    sides = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    past = np.einsum("ij,kij->ki", edge_m, sides)
    normal, rise = sides.sum(axis=0), past.sum(axis=0)
    size = np.linalg.norm(normal, axis=1) * np.linalg.norm(edge_m, axis=1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.einsum("ij,ij->i", a, normal) / rise
    inside = (past >= 0.0).all(axis=0) | (past <= 0.0).all(axis=0)
    return inside & (share >= 0.0) & (share <= 1.0) & (np.abs(rise) > _LEAST_SLOPE * size)

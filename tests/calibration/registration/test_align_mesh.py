"""Registration of meshes: visibility, renderings, pictures, the motion found, and failures."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hand_registrations import ARRAY, CENTRE_M, RADAR, errors, motion, truth
from scipy.ndimage import gaussian_filter
from scipy.signal import convolve2d
from scipy.spatial.transform import Rotation
from shapes import box, sphere

import clradar
from calibration import Alignment, Place, align_mesh
from calibration.registration.mesh_fit import fit_mesh, initial_log_brightness
from calibration.registration.mesh_rendering import Aperture, Canvas, MeasuredImage, MeshRendering
from clradar.errors import CompareError
from clradar.tracing.visible_surface import VisibleSurface
from measurement_io import read_transform, save_volume

STEP_M = 2e-3


APERTURE = Aperture(ARRAY, 77e9)
SHOWN = MeasuredImage(
    np.arange(41) * STEP_M, np.arange(31) * STEP_M, np.random.default_rng(2).random((31, 41)),
    np.full((31, 41), 0.3), (STEP_M, STEP_M),
)  # fmt: skip


@pytest.mark.parametrize("lit", [np.s_[:, :], np.s_[12:15, 20:22], np.s_[:2, -1:], np.s_[:0, :0]])
def test_a_picture_is_convolved_wherever_it_is_lit(lit):
    drawn = np.zeros((2, 3, 31, 41))
    inside = (1, slice(None), *lit)
    drawn[inside] = np.random.default_rng(3).normal(size=drawn.shape)[inside]
    seen = Canvas(SHOWN, APERTURE).convolved(drawn)
    pattern = APERTURE.point_spread(0.3, SHOWN.step_m)
    for one, of in zip(seen.reshape(6, 31, 41), drawn.reshape(6, 31, 41), strict=True):
        # 1e-14: some hundred sums in double precision of numbers of about 1.
        assert np.abs(one - convolve2d(of, pattern, "same")).max() < 1e-14 * max(1, np.ptp(of))


def test_a_blurred_picture_is_that_of_a_blurred_image():
    drawn = np.zeros((31, 41))
    drawn[15, 20] = 1.0
    sharp, soft = (Canvas(SHOWN, APERTURE, blur_m) for blur_m in (0.0, 2 * STEP_M))
    blurred = gaussian_filter(sharp.convolved(drawn), 2.0, mode="constant", truncate=8.0)
    # The Gaussian in frequency and that of samples in space differ by their aliases, exp(-2 pi^2).
    middle = np.s_[9:22, 12:29]  # as far from the edge as the blur reaches
    assert np.abs(soft.convolved(drawn) - blurred)[middle].max() < 1e-4 * blurred.max()
    assert soft.power.max() == pytest.approx(1.0)


OWN_RENDERING_M = 5e-5
"""A fit to the mesh's own rendering has no noise: the convergence tolerance of 1e-5 m is what is
left, and a factor of five for the visibility, which is updated every 0.2 mm only."""


@pytest.fixture(scope="module")
def found(registered) -> Alignment:
    return registered.result.alignment


# Visibility and rendering


def test_point_spread_is_that_of_the_exact_image(device):
    """Against the image of a point by the exact sum over all pairs, at the centre frequency."""
    narrow = clradar.Waveform(np.array([77e9]))
    segments_m = [np.linalg.norm(CENTRE_M - a, axis=1) for a in (ARRAY.tx_m, ARRAY.rx_m)]
    path_m = segments_m[0][:, None] + segments_m[1]
    data = np.exp(-2j * np.pi * 77e9 * path_m / 299_792_458.0)[:, :, None]
    capture = clradar.Capture(data.astype(np.complex64), ARRAY, narrow)
    grid = clradar.VoxelGrid.from_extent((-0.024, 0.024), (-0.024, 0.024), (0.3, 0.3), 2e-3)
    volume = clradar.backproject(capture, grid, method="exact", device=device)
    power = np.abs(volume.data[0]).astype(np.float64) ** 2
    pattern = APERTURE.point_spread(0.3, (2e-3, 2e-3))
    assert pattern.shape == power.shape
    # float32 phases of 160 turns: 1e-5 of the peak.
    assert np.abs(pattern / pattern.max() - power / power.max()).max() < 1e-4
    # The lateral resolution is wavelength x range / (2 x 14 cm) = 4.2 mm; its square 17 mm^2.
    assert 14e-6 < APERTURE.cell_m2(0.3) < 22e-6


def empty_image(range_m=0.3):
    axis_m = np.arange(-0.06, 0.0601, 2e-3)
    shape = (len(axis_m), len(axis_m))
    return MeasuredImage(axis_m, axis_m, np.ones(shape), np.full(shape, range_m), (2e-3, 2e-3))


def rendering_of_itself(mesh, transform, device):
    """The noiseless rendering of a mesh as if it were measured."""
    with VisibleSurface(mesh, 1.0, 2.0, device) as surface:
        image = MeshRendering(surface, empty_image(), APERTURE)
        image.update_visibility(transform)
        power, range_m = image.render(transform, initial_log_brightness())
    power = power / power.max()
    return replace(empty_image(), power=power, range_m=np.where(power > 0.01, range_m, np.nan))


def test_fit_to_its_own_rendering_is_exact(device):
    vertices, faces = box((0, 0, 0.3), (0.05, 0.04, 0.03))
    vertices = vertices + 0.006 * np.sin(vertices[:, [1, 2, 0]] / 0.011)
    mesh = clradar.Scene(vertices, faces)
    there = motion((3.0, -4.0, 5.0), (0.003, 0.002, 0.004))
    measured = rendering_of_itself(mesh, there, device)
    with VisibleSurface(mesh, 1.0, 2.0, device) as surface:
        image = MeshRendering(surface, measured, APERTURE)
        fit = fit_mesh(image, motion((1.0, -3.0, 2.0), (0.001, 0.004, 0.003)),
                       initial_log_brightness(), 60)  # fmt: skip
    assert fit.converged
    position_m, rotation_deg = errors(fit.transform, there)
    assert position_m < OWN_RENDERING_M
    assert rotation_deg < np.degrees(OWN_RENDERING_M / 0.02)


# The motion


def test_error_is_within_its_covariance(found):
    """Chi squared with six degrees of freedom."""
    motion_off = truth() @ np.linalg.inv(found.transform)
    turn = Rotation.from_matrix(motion_off[:3, :3]).as_rotvec()
    shift = motion_off[:3, :3] @ found.centre_m + motion_off[:3, 3] - found.centre_m
    off = np.concatenate([turn, shift])
    square = off @ np.linalg.solve(found.covariance, off)
    assert 0.0 < square < 22.5  # one in a thousand is above


def test_doubts_are_remarked(found):
    text = found.report()
    assert text.startswith("The mesh is shifted by")
    assert "of the measured amplitude lies on it" in text
    assert "Doubtful" not in text
    assert json.loads(json.dumps(found.to_dict()))["transform"] == found.transform.tolist()
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0, 0, 70], degrees=True).as_matrix()
    place = Place(np.array([0.0, 0.05, 0.3]), 1e-4, 4.0, 5e-3, 3.0)
    worse = {"residual_ratio": 2.5, "places": (place,)}
    doubtful = replace(found, transform=turned, overlap=0.6, converged=False, **worse)
    still, beyond, other, beyond_noise = doubtful.remarks()
    assert "2.5 times what the noise explains" in beyond_noise
    assert place.text() in beyond_noise
    assert "still changed in the last iteration" in still
    assert "--search-deg" in beyond
    assert "0.60" in other
    assert doubtful.report().count("Doubtful") == 3
    assert doubtful.to_dict()["remarks"] == [still, beyond, other, beyond_noise]


# Failures


@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_wrong_unit_is_noticed(measured, hand, factor):
    wrong = clradar.Scene(factor * hand.vertices_m, hand.faces)
    with pytest.raises(CompareError, match=r"could not align, because the mesh is too .*--unit"):
        align_mesh(measured, wrong, device="pocl")


def test_another_object_is_a_failure(measured):
    ball = clradar.Scene(*sphere(CENTRE_M, 0.02, 3))
    with pytest.raises(CompareError, match=r"could not align, because only .* lies on the mesh"):
        align_mesh(measured, ball, **RADAR, search_deg=5.0, max_iterations=5)


def test_a_mesh_that_reaches_to_the_radar_is_refused():
    """Its samples there have no direction, and the fit no unique step."""
    axis_m = np.arange(-15, 16) * 3e-3
    x, y = np.meshgrid(axis_m, axis_m)
    lit = np.maximum(np.abs(x - 0.004), np.abs(y)) < 0.0205
    depth = clradar.DepthMap(np.where(lit, 0.305, np.nan), 1.0 * lit, axis_m, axis_m, 20.0)
    corners = [[0, 0, 0], [0.02, -0.02, 0.3], [0.02, 0.02, 0.3], [-0.02, 0.02, 0.3]]
    mesh = clradar.Scene(corners, [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(CompareError, match="could not align, because"):
        align_mesh(depth, mesh, correct_bias=False, search_deg=5.0, max_iterations=4, device="pocl")


# The command


def test_command_writes_what_simulate_reads(cli, measured, hand, found, monkeypatch):
    given = {}

    def aligned(volume, mesh, **options):
        given.update(options, image=volume, mesh=mesh)
        return found

    monkeypatch.setattr("calibration.align_mesh", aligned)
    save_volume("measured.h5", measured)
    mesh = trimesh.Trimesh(1e3 * hand.vertices_m, hand.faces, process=False)
    mesh.export("hand.ply")
    options = "--unit mm --quick --search-deg 15 -o transform.json"
    printed = cli.ok(f"align measured.h5 --mesh hand.ply {options}").out
    assert np.array_equal(given["image"].data, measured.data)
    # The mesh file has float32 millimetres.
    assert np.abs(given["mesh"].vertices_m - hand.vertices_m).max() < 1e-7
    assert (given["search_deg"], given["correct_bias"]) == (15.0, False)
    assert read_transform("transform.json") == pytest.approx(found.transform)
    record = json.loads(Path("transform.json").read_text())
    assert record["command"] == "align"
    assert {i["file"] for i in record["inputs"]} == {"measured.h5", "hand.ply"}
    assert np.array(record["covariance"]).shape == (6, 6)
    assert "The mesh is shifted" in printed

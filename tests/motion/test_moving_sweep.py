"""Motions and their files, hands whose pose changes, and sweeps over scenes that move."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from nightly import nightly
from shapes import sphere

import clradar
from clradar import AntennaArray, MovingBody, MovingHand, MovingScene, RigidMotion, Scene
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import MeasurementError, ModelError
from clradar.hand import HandShape, pose_by_name, write_pose
from clradar.motion.instants import Piece
from clradar.tracing.surface_samples import sampled_as


def written(folder: Path, text: str) -> Path:
    path = folder / "motion.toml"
    path.write_text(text)
    return path


def test_places_and_turns_are_interpolated():
    motion = RigidMotion(
        [1.0, 2.0, 4.0],
        [(0, 0, 0), (0, 0, 0.1), (0, 0.2, 0.1)],
        [(0, 0, 0), (0, 0, 4 * np.pi), (0, 0, 4 * np.pi)],
        about_m=(0.1, 0, 0),
    )
    assert (motion.at(0.0) == np.eye(4)).all()
    quarter = motion.at(1.125)  # a quarter of a turn of two about z at x = 0.1
    assert quarter[:3, :3] @ (1, 0, 0) == pytest.approx((0, 1, 0), abs=1e-12)
    assert quarter @ (0.1, 0, 0, 1) == pytest.approx((0.1, 0, 0.0125, 1))
    assert motion.at(9.0)[:3, 3] == pytest.approx((0, 0.2, 0.1), abs=1e-12)
    # From rest to rest with the least jerk: 10 t^3 - 15 t^4 + 6 t^5.
    smooth = RigidMotion([0, 1], [(0, 0, 0), (0, 0, 1)], profile="smooth")
    assert [smooth.at(t)[2, 3] for t in (0.25, 0.5)] == pytest.approx([53 / 512, 0.5], abs=1e-15)
    both = RigidMotion([0, 1], np.zeros((2, 3)), [(np.pi / 2, 0, 0), (0, np.pi / 2, 0)]).at(0.5)
    # Half of the shortest way: the rotation R with R R = (last) (first)^-1 after the first one.
    first = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    last = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    way = first.T @ both[:3, :3]
    assert first @ way @ way == pytest.approx(last, abs=1e-12)


def test_a_file_has_bodies_hands_and_the_order_of_switching(tmp_path):
    (tmp_path / "bent.toml").write_text(
        'name = "bent"\n[joints.index-finger-phalanx-intermediate]\nflexion_deg = 80'
    )
    motion = clradar.read_motion(
        written(
            tmp_path,
            """
            sweep.step_us = 1
            [[body]]
            mesh = "ball.ply"
            profile = "smooth"
            place = [{ time_s = 0 }, { time_s = 2, shift_mm = [0, 0, 20], turn_deg = [0, 90, 0] }]
            [[hand]]
            handedness = "left"
            velocity_mm_per_s = [0, 0, 50]
            pose = [{ time_s = 0, pose = "A" }, { time_s = 1, pose = "bent.toml" }]
            """,
        )
    )
    assert motion.bodies["ball.ply"].at(1.0)[2, 3] == pytest.approx(0.01)
    assert motion.hands[0].poses[1].name == "bent"
    assert [path.name for path in motion.files] == ["motion.toml", "bent.toml"]
    radar = clradar.AntennaArray([(0, 0, 0), (0.01, 0, 0)], [(0, 0.01, 0)])
    (timing,) = motion.timings([radar], clradar.Waveform([72e9, 73e9]))
    assert timing.times_s[:, 0].tolist() == [[0, 1e-6], [2e-6, 3e-6]]
    with pytest.raises(ModelError, match=r"motion.toml: body.mesh: .* got 'ball.ply'"):
        motion.scene({})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"motion.toml: body: expected \[\[body\]\] or \[\[hand\]\]"),
        ("[[body]]\nvelocty_mm_per_s = [0, 0, 1]", r"did you mean 'velocity_mm_per_s'"),
        ("[[body]]\nabout_mm = [0, 0, 1]", r"body\[0\].place: expected either"),
        ("[[body]]\nvelocity_mm_per_s = [0, 1]", r"mm_per_s\[2\]: expected a value, got nothing"),
        ("[[body]]\nplace = [{ shift_mm = [0, 0, 1] }]", r"place\[0\].time_s: expected a time"),
        ("[[body]]\nplace = [{ time_s = 1 }, { time_s = 1 }]", r"body\[0\].*strictly ascending"),
        ("[[body]]\nturn_deg_per_s = [0, 0, 1]\nbeyond = 'hold'", r"beyond: expected \[\[place"),
        ("[[hand]]\npose = [{ time_s = 0, pose = 'nonesuch' }]", r"hand\[0\].*nonesuch"),
        ("[[hand]]\npose = [{ time_s = 0, pose = 'no.toml' }]", r"no.toml: expected a pose"),
        ("sweep.order = 'rx'\n[[hand]]\npose = [{ time_s = 0, pose = 'A' }]", "sweep.order"),
        ("[[hand]]\nedge_mm = 0\npose = [{ time_s = 0, pose = 'A' }]", r"hand\[0\].*edge_length_m"),
        ("[[hand]]\nrig = 'x.glb'\ngirth = 1\npose = [{ time_s = 0, pose = 'A' }]", "girth.*rig"),
    ],
)  # fmt: skip
def test_mistakes_name_the_file_and_the_key(tmp_path, text, said):
    with pytest.raises(MeasurementError, match=said):
        clradar.read_motion(written(tmp_path, text))


TURN = RigidMotion([0.0, 1.0], [(0, 0, 0), (0.01, 0, 0.03)], [(0, 0, 0), (0, 0.4, 0.1)])


def test_a_hand_passes_through_its_poses_about_its_centre(tmp_path):
    write_pose(tmp_path / "mine.toml", pose_by_name("W"))
    poses = ["A", tmp_path / "mine.toml", pose_by_name("flat")]
    hand = MovingHand([0.0, 1.0, 2.0], poses, center_m=(0.0, 0.01, 0.4))
    for time_s, name in ((-1.0, "A"), (1.0, "W"), (9.0, "flat")):
        assert hand.pose(time_s).joints == pose_by_name(name).joints
    joints_m = np.concatenate([hand.joints_m(time_s) for time_s in (0.0, 1.0, 2.0)])
    middle_m = 0.5 * (joints_m.min(axis=0) + joints_m.max(axis=0))
    np.testing.assert_allclose(middle_m, (0.0, 0.01, 0.4), rtol=0, atol=1e-15)
    # The wrist stays while the pose changes.
    np.testing.assert_allclose(hand.joints_m(0.3)[0], hand.joints_m(1.7)[0], rtol=0, atol=1e-15)


@pytest.mark.device
def test_joints_are_those_of_the_mesh():
    shape = HandShape(length_m=0.17, girth=0.95)
    hand = MovingHand(
        [0.0, 1.0], ["F", "flat"], motion=TURN, shape=shape, handedness="left", edge_length_m=4e-3
    )
    for time_s in (0.0, 0.7):
        # Sums of a few terms below 1 m in double precision.
        found_m = hand.mesh(time_s).joints_m
        np.testing.assert_allclose(found_m, hand.joints_m(time_s), rtol=0, atol=1e-14)
        rotation = hand.transform(time_s)[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("poses", "more", "error", "said"),
    [
        (["A"], {}, ModelError, "one for each of 2 times"),
        (["A", "nonesuch"], {}, ModelError, "pose: expected one of"),
        (["A", 7], {}, ModelError, "names, pose files or poses, got 7"),
        (["A", "none.toml"], {}, MeasurementError, "none.toml"),
        (["A", "B"], {"profile": "fast"}, ModelError, "profile"),
        (["A", "B"], {"edge_length_m": 0.1}, ModelError, "edge_length_m"),
        (["A", "B"], {"motion": 1}, ModelError, "MovingHand.motion"),
    ],
)
def test_what_is_no_moving_hand_is_refused(poses, more, error, said):
    with pytest.raises(error, match=said):
        MovingHand([0.0, 1.0], poses, **more)


WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 16)
LINE_M = np.zeros((24, 3))
LINE_M[:, 0] = 6e-3 * (np.arange(24) - 11.5)
RADAR = AntennaArray(LINE_M, [[0.0, 0.01, 0.0], [0.01, -0.02, 0.0]], "line")
POINT_M = np.array([0.005, 0.01, 0.3])
STEP_S = 31.25e-6


def point() -> Scene:
    """A metal ball of 1 mm radius: its echo moves as that of a point does."""
    return Scene(*sphere(tuple(POINT_M), 1e-3, 3))


def moving_point(velocity_m_per_s: tuple[float, float, float]) -> MovingScene:
    return MovingScene([MovingBody(point(), RigidMotion.steady(velocity_m_per_s))])


def echo(
    at_m: np.ndarray, radar: AntennaArray = RADAR, waveform: clradar.Waveform = WAVEFORM
) -> np.ndarray:
    """Samples of a point that is at `at_m`, (n_tx, 1, n_freq, 3), when each is recorded."""
    legs_m = np.linalg.norm(at_m - radar.tx_m[:, None, None], axis=3)
    legs_m = legs_m + np.linalg.norm(at_m - radar.rx_m[None, :, None], axis=3)
    phase: np.ndarray = -2 * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S * legs_m
    return np.exp(1j * phase)


@pytest.mark.parametrize(
    ("velocity", "order"), [((0.3, -1.0, 0.5), "tx"), *nightly([((2.0, 0.0, 0.0), "frequency")])]
)
def test_a_moving_point_has_the_phase_of_its_way_at_every_tx_and_frequency(velocity, order):
    radar = RADAR.part(slice(None, None, 3), slice(None))
    timing = clradar.SweepTiming.in_order(8, 16, step_s=STEP_S, order=order)
    settings = clradar.SimulationSettings(estimator="physical", samples_per_mm2=30)
    capture = clradar.simulate_moving(
        moving_point(velocity), radar, WAVEFORM, timing=timing, start_s=0.01, settings=settings
    )
    still = clradar.simulate(point(), radar, WAVEFORM, settings=settings)
    way_m = POINT_M + (timing.times_s + 0.01)[..., None] * np.array(velocity)
    wanted = echo(way_m, radar) / echo(np.broadcast_to(POINT_M, way_m.shape), radar)
    turned = np.angle(capture.data / still.data / wanted)
    assert np.ptp(np.unwrap(np.angle(wanted), axis=0)) > 3.0
    # The mirror point wanders on the ball by what its radius is of the distance.
    assert np.abs(turned).max() < 0.06


ONE_MM = np.array([0.0, 0.0, 1e-3])
# What is where it was at the ends of the sweep, at its eighths, and at its twelfths.
UNSEEN = {
    "twitch": RigidMotion([0.53, 0.56, 0.59], [0 * ONE_MM, 3 * ONE_MM, 0 * ONE_MM]),
    "twitch of the first Tx": RigidMotion([0.01, 0.03, 0.05], [0 * ONE_MM, 3 * ONE_MM, 0 * ONE_MM]),
    "a whole turn between two keys": RigidMotion(
        [0.4, 0.5], np.zeros((2, 3)), [[0, 0, 0], [0, 2 * np.pi, 0]], POINT_M - [3e-3, 0, 0]
    ),
    "12 wavelengths": RigidMotion.steady(
        (0, 0, 6 * SPEED_OF_LIGHT_M_PER_S / WAVEFORM.frequencies_hz.max())
    ),
}  # fmt: skip


@pytest.mark.parametrize("count", [1, 5, 12])
def test_polynomials_through_as_many_instants_are_exact(count):
    piece, times_s = Piece.between(2.0, 5.0, count), np.linspace(2.0, 5.0, 31)
    shares = zip(piece.shares(times_s), piece.times_s, strict=True)
    found = sum(share * at_s ** (count - 1) for share, at_s in shares)
    np.testing.assert_allclose(found, times_s ** (count - 1), atol=1e-12 * 5.0 ** (count - 1))


@pytest.mark.parametrize("name", [[*UNSEEN][1], *nightly([*UNSEEN][:1] + [*UNSEEN][2:])])
def test_what_comes_back_between_two_probes_is_seen(name):
    # One Rx beside the Tx, which are close: lengths alias alike for all pairs.
    radar = RADAR.part(slice(10, 13), [0])
    timing = clradar.SweepTiming.in_order(3, 40, step_s=1 / 119)
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 40)
    settings = clradar.SimulationSettings(estimator="physical", samples_per_mm2=30)
    moving = MovingScene([MovingBody(point(), UNSEEN[name])])
    capture = clradar.simulate_moving(moving, radar, waveform, timing=timing, settings=settings)
    still = clradar.simulate(point(), radar, waveform, settings=settings)
    at = np.stack([UNSEEN[name].at(time_s) for time_s in timing.times_s.ravel()])
    way_m = (at[:, :3, :3] @ POINT_M + at[:, :3, 3]).reshape(*timing.times_s.shape, 3)
    wanted = echo(way_m, radar, waveform) / echo(
        np.broadcast_to(POINT_M, way_m.shape), radar, waveform
    )
    assert np.abs(wanted - 1).max() > 1.0
    # The mirror point wanders on the ball by what its radius is of the distance.
    assert np.abs(np.angle(capture.data / still.data / wanted)).max() < 0.06
    assert capture.meta["movement"]["phase_error_db"] <= -50


@pytest.mark.parametrize("poses", [["flat", "A", "flat"], ["A", "A", "A", "flat", "A"]])
def test_skin_that_tears_is_warned_of(poses):
    radar = RADAR.part([0, 12], [0])
    timing = clradar.SweepTiming.in_order(2, 2, step_s=1 / 3)
    hand = MovingHand(np.linspace(0.0, 1.0, len(poses)), poses, edge_length_m=4e-3)
    waveform, moving = clradar.Waveform.sfcw(72e9, 72.1e9, 2), MovingScene([hand])
    with pytest.warns(clradar.ClradarWarning) as warned:
        clradar.simulate_moving(moving, radar, waveform, timing=timing, samples_per_mm2=0.1)
    assert any("its skin, carried from the middle, tears" in str(one.message) for one in warned)


@pytest.mark.filterwarnings("error:simulate. the scene is as wide")
def test_parts_of_an_array_warn_of_no_lobes_that_it_has_not():
    corners = [(x_m, y_m, 0.3) for x_m in (-0.06, 0.06) for y_m in (-0.08, 0.08)]
    scene = Scene.combine(Scene(*sphere(corner_m, 8e-3, 1)) for corner_m in corners)
    body = MovingBody(scene, RigidMotion.steady((0.0, 0.0, 3.0)))
    timing = clradar.SweepTiming.in_order(94, 2, step_s=160e-6)
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 2)

    def stop(done: int, total: int) -> None:
        """After the first part: warnings are errors here."""
        raise InterruptedError

    with pytest.raises(InterruptedError):
        clradar.simulate_moving(
            MovingScene([body]), clradar.arrays.qar50(), waveform, timing=timing, progress=stop,
            samples_per_mm2=0.1,
        )  # fmt: skip


@pytest.mark.parametrize("order", ["tx", *nightly(["frequency"])])
def test_a_point_that_goes_away_is_shifted_in_the_image_as_theory_says(order):
    # Of the range, because lengths grow over the frequencies; across, because they grow over the
    # Tx, as they do for a point at another angle.
    speed = 0.2 if order == "tx" else 0.04
    timing = clradar.SweepTiming.in_order(24, 16, step_s=STEP_S, order=order)
    capture = clradar.simulate_moving(
        moving_point((0.0, 0.0, speed)), RADAR, WAVEFORM, timing=timing, samples_per_mm2=30,
        estimator="physical",
    )  # fmt: skip
    grid = clradar.VoxelGrid.from_extent((-0.03, 0.03), (0.01, 0.01), (0.28, 0.33), 0.5e-3)
    # One Rx: where its own phase does not say the angle again.
    one_rx = clradar.Capture(capture.data[:, :1], RADAR.part(slice(None), [0]), WAVEFORM)
    volume = clradar.backproject(one_rx, grid, window="hann", method="exact")
    z, _, x = np.unravel_index(np.abs(volume.data).argmax(), volume.data.shape)
    between_tx_s = STEP_S * (16 if order == "tx" else 1)
    between_steps_s = STEP_S * (1 if order == "tx" else 24)
    across_m = -2 * speed * between_tx_s / 6e-3 * 0.3
    away_m = speed * timing.end_s / 2
    away_m += 77e9 / np.diff(WAVEFORM.frequencies_hz)[0] * speed * between_steps_s
    found_m = grid.x_m[x] - POINT_M[0], grid.z_m[z] - POINT_M[2]
    assert found_m == pytest.approx((across_m, away_m), abs=1.1e-3)
    assert max(abs(across_m), abs(away_m)) > 1.9e-3


@pytest.mark.parametrize("estimator", ["expected", *nightly(["stochastic", "physical"])])
def test_a_scene_that_stays_has_the_bits_of_a_still_one(estimator):
    ball = Scene(*sphere(tuple(POINT_M), 0.01, 3))
    moving = MovingScene([MovingBody(ball, RigidMotion([0.0, 1.0], np.zeros((2, 3))))])
    settings = clradar.SimulationSettings(estimator=estimator, samples_per_mm2=4)
    capture = clradar.simulate_moving(moving, RADAR, WAVEFORM, settings=settings)
    still = clradar.simulate(ball, RADAR, WAVEFORM, settings=settings)
    assert np.array_equal(capture.data, still.data)


def test_frames_without_duration_are_the_frames_of_a_still_hand():
    motion = RigidMotion.steady(turn_rad_per_s=(0, 1, 0), about_m=(0, 0, 0.3))
    hand = MovingHand(
        [0.0, 1.0], ["A", "flat"], motion=motion, edge_length_m=4e-3, handedness="left"
    )
    timing = clradar.SweepTiming.in_order(24, 16, step_s=0.0)
    capture = clradar.simulate_moving(
        MovingScene([hand]), RADAR, WAVEFORM, timing=timing, start_s=0.4, samples_per_mm2=0.5
    )
    still = Scene.from_mesh(hand.mesh(0.4))
    then = clradar.simulate(still, RADAR, WAVEFORM, samples_per_mm2=0.5)
    assert np.array_equal(capture.data, then.data)
    between = hand.during(0.39, 0.41)
    # The skin of one time, carried to another: on the surface there, whose vertices are others.
    carried = trimesh.proximity.closest_point(
        hand.mesh(0.39).to_trimesh(), between.scene(0.39).vertices_m[::40]
    )[1]
    assert np.quantile(carried, 0.95) < 0.5e-3


@pytest.mark.slow
def test_a_moving_hand_is_in_every_sample_where_it_is_then():
    moving = MovingScene([MovingHand([-0.2, 0.2], ["S", "flat"], edge_length_m=4e-3)])
    timing = clradar.SweepTiming.in_order(24, 16, step_s=20e-6)
    settings = clradar.SimulationSettings(estimator="expected", samples_per_mm2=0.2)
    capture = clradar.simulate_moving(moving, RADAR, WAVEFORM, timing=timing, settings=settings)
    bodies = [body.during(0.0, timing.end_s) for body in moving.bodies]
    reference = moving.seen(bodies, 0.5 * timing.end_s)
    difference, power, unmoved = 0.0, 0.0, 0.0
    still = clradar.simulate(reference, RADAR, WAVEFORM, settings=settings).data
    with sampled_as(reference):
        for tx, step in ((0, 3), (5, 0), (12, 9), (23, 15)):
            scene = moving.seen(bodies, timing.times_s[tx, 0, step])
            then = clradar.simulate(scene, RADAR, WAVEFORM, settings=settings).data[tx, :, step]
            difference += np.sum(np.abs(capture.data[tx, :, step] - then) ** 2)
            unmoved += np.sum(np.abs(still[tx, :, step] - then) ** 2)
            power += np.sum(np.abs(then) ** 2)
    assert 10 * np.log10(difference / power) < -35
    assert 10 * np.log10(unmoved / power) > -20


def test_a_timing_of_another_radar_is_refused():
    timing = clradar.SweepTiming.in_order(23, 16)
    with pytest.raises(ModelError, match=r"timing: expected times of 24 Tx, 1 or 2 Rx and 16 freq"):
        clradar.simulate_moving(moving_point((0, 0, 1)), RADAR, WAVEFORM, timing=timing)


def test_what_is_too_fast_to_follow_is_refused():
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    timing = clradar.SweepTiming.in_order(24, 128, step_s=1.0)
    moving = MovingScene([MovingBody(point(), RigidMotion.steady(turn_rad_per_s=(0, 0, 300.0)))])
    with pytest.raises(ModelError, match="2048 instants"):
        clradar.simulate_moving(moving, RADAR, waveform, timing=timing)

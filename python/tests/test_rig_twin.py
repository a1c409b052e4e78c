"""The virtual rig and the twin on it."""

from __future__ import annotations

import json

import numpy as np
import pytest
import springtwin
from conftest import Program
from springtwin import Rig, Robot, Twin

BENT = np.array([15e3, -8e3, -8e3, 0, 5e3, 0])


def test_the_same_seed_gives_the_same_frames_and_another_one_other_noise() -> None:
    def run(seed: int) -> tuple[springtwin.Frame, springtwin.Frame]:
        rig = Rig(seed=seed, rings=4)
        first = rig.step(BENT, 20)
        return first, rig.step(BENT, 200)

    (a, last_a), (b, last_b), (c, _) = run(1), run(1), run(2)
    np.testing.assert_array_equal(a.observation, b.observation)
    np.testing.assert_array_equal(last_a.truth.pads, last_b.truth.pads)
    np.testing.assert_array_equal(last_a.raw.spring_counts, last_b.raw.spring_counts)
    assert not np.array_equal(a.raw.gyro_rad_s, c.raw.gyro_rad_s)
    rig = Rig(seed=2, rings=4)
    rig.step(BENT, 50)
    rig.reset(seed=1)
    np.testing.assert_array_equal(rig.step(BENT, 20).observation, a.observation)


def test_what_is_delivered_is_apart_from_the_truth_and_close_to_it() -> None:
    rig = Rig(rings=4)
    frame = rig.step(BENT, 600)
    assert frame.raw.t_s == pytest.approx(2.0 + 6.0)
    assert frame.observation.shape == (30,) and frame.sensors.read.all()
    off = np.abs(frame.sensors.springs_m - frame.truth.springs_m)
    # The springs hang off their drawing by some tenths of a millimetre.
    assert 1e-6 < off.max() < 3e-3
    assert np.all(frame.raw.spring_hz > 1e4)
    np.testing.assert_allclose(frame.raw.set_pa, BENT, atol=1e-6)
    np.testing.assert_allclose(frame.raw.chamber_pa, BENT, atol=500)
    np.testing.assert_allclose(np.linalg.norm(frame.raw.accel_m_s2, axis=1), 9.81, atol=0.5)
    # Other physics than the model's, of the same arm.
    model = Robot().solve(BENT)
    assert 1e-5 < np.linalg.norm(model.position_m - frame.truth.position_m) < 1e-2


def test_set_pressures_keep_the_rate_of_the_robot() -> None:
    rig, robot = Rig(rings=4), Robot()
    most = robot.pressure_rate_pa_s * rig.dt_s
    before = rig.frame().raw.set_pa
    for _ in range(5):
        now = rig.step(np.full(6, robot.pressure_range_pa[1])).raw.set_pa
        assert np.all(now - before <= most + 1e-6) and np.all(now > before)
        before = now


def test_hidden_effects_and_pushes_act() -> None:
    ids = {h.id for h in springtwin.hidden_effects()}
    assert {"spring-calibration", "payload"} <= ids
    healthy = Rig(rings=4).step(BENT, 100)
    spoiled = Rig(rings=4, hide=["spring-calibration:4=1.06,0.002"]).step(BENT, 100)
    off = spoiled.sensors.springs_m - healthy.sensors.springs_m
    assert off[3] == pytest.approx(0.06 * healthy.truth.springs_m[3] + 0.002, abs=2e-3)
    # What is hidden in a sensor moves nothing but the last bits.
    np.testing.assert_allclose(spoiled.truth.pads, healthy.truth.pads, rtol=0, atol=1e-12)
    rig = Rig(rings=4)
    rig.push([1.0, 0, 0])
    pushed = rig.step(np.zeros(6), 300).truth.position_m[0]
    assert pushed > Rig(rings=4).step(np.zeros(6), 300).truth.position_m[0] + 1e-3


def test_refusals_of_the_rig() -> None:
    for options, text in [
        ({"hide": ["nonsense"]}, "there is no hidden effect 'nonsense'"),
        ({"hide": ["leak:9"]}, "there are 6"),
        ({"payload_kg": 90.0}, "more than robot"),
        ({"stiffness": 0.0}, "give a number above 0"),
        ({"rings": 1}, "rings per segment"),
    ]:
        with pytest.raises(springtwin.Error, match=text):
            Rig(**options)  # type: ignore[arg-type]
    rig = Rig(rings=4)
    with pytest.raises(springtwin.Error, match="outside of the range"):
        rig.step(np.full(6, 99e3))
    with pytest.raises(springtwin.Error, match="3 pressures: give 6"):
        rig.step(np.zeros(3))


def test_goto_equals_the_command_and_the_twin_stays_on_its_rig(program: Program) -> None:
    shown = program("goto", "60,40,-300")
    twin = Twin()
    assert twin.mode == "disarmed"
    motion = twin.goto([0.06, 0.04, -0.3])
    assert motion.reached and twin.mode == "at goal"
    for name in ("steps", "settled_steps", "settled_s", "mean_mm", "rmse_mm", "p95_mm", "max_mm", "saturated_ratio", "frames"):
        assert motion.measures[name] == shown[name], name
    assert motion.measures["tip_error_mm"] == shown["tip_error_mm"]
    assert np.isfinite(motion.truth).all() and motion.truth.shape == (len(motion.t_s), 7)
    end = motion.t_s[-1]
    back = twin.goto([0.03, 0.0, -0.31])
    assert back.reached and back.t_s[0] > end and back.mean_mm < 2.0
    np.testing.assert_allclose(back.truth[0], motion.truth[-1], atol=1e-3)


def test_reach_equals_the_command_and_what_is_out_of_reach_is_refused(program: Program) -> None:
    shown = program("reach", "0,0,-600")
    twin = Twin()
    found = twin.reach([0, 0, -0.6])
    assert found.state == shown["state"] == "unreachable"
    assert found.distance_m * 1e3 == pytest.approx(shown["distance_mm"], rel=1e-12)
    np.testing.assert_allclose(found.nearest_m * 1e3, shown["nearest_mm"], rtol=1e-12)
    assert found.limiting_chamber is not None
    assert found.limiting_chamber[0] == shown["limiting_chamber"]["chamber"]
    printed = program("goto", "0,0,-600", fails=True)
    with pytest.raises(springtwin.Error) as e:
        twin.goto([0, 0, -0.6])
    assert str(e.value) in printed
    # A refusal leaves the twin as it was.
    assert twin.goto([0.06, 0.04, -0.3]).reached


def test_follow_equals_the_command(program: Program) -> None:
    shown = program("follow", "--path", "circle", "--size", 20, "--speed", 5)
    motion = Twin().follow("circle", size_m=0.02, speed_m_s=5e-3)
    for name in ("mean_mm", "rmse_mm", "p95_mm", "max_mm", "saturated_ratio", "steps"):
        assert motion.measures[name] == shown[name], name
    with pytest.raises(springtwin.Error, match="there is no path 'square'"):
        Twin().follow("square")
    with pytest.raises(springtwin.Error, match="choose another one"):
        Twin().follow("eight", speed_m_s=1.0)


def test_own_waypoints_are_followed() -> None:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    way = np.stack([0.015 * np.cos(angle), 0.015 * np.sin(angle), np.full(24, -0.31)], axis=1)
    motion = Twin(controller="paper-adrc").follow(way, speed_m_s=5e-3)
    assert motion.measures["waypoints"] == 24 and motion.mean_mm < 5.0
    assert json.dumps(motion.measures)

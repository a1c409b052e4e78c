"""The model at rest: equal to the command, exact derivatives, errors in sentences."""

from __future__ import annotations

import pickle
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import springtwin
from conftest import ROOT, Program
from springtwin import Robot

ROWS = 20


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot()


def batch(program: Program, folder: Path, cases: pd.DataFrame, *options: object) -> pd.DataFrame:
    """What `sim solve --batch` makes of cases."""
    cases.to_csv(folder / "cases.csv", index=False)
    out = folder / f"solved{len(options)}.parquet"
    program("sim", "solve", "--batch", folder / "cases.csv", "--out", out, *options)
    return pd.read_parquet(out)


def test_solve_equals_the_command(program: Program, robot: Robot, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    pressures = robot.sample(ROWS, seed=3)
    payload, force = rng.uniform(0, 0.3, ROWS), rng.normal(0, 0.5, (ROWS, 3))
    cases = pd.DataFrame(pressures / 1e3, columns=[f"p{i}_kpa" for i in range(1, 7)])
    # The command reads kPa: what it solves is what the table holds.
    pressures = cases.to_numpy() * 1e3
    cases["payload_kg"] = payload
    cases[["force_x_n", "force_y_n", "force_z_n"]] = force
    table = batch(program, tmp_path, cases)
    poses, springs, imus = robot.solve(pressures, payload, force)
    assert poses.shape == (ROWS, 7) and springs.shape == (ROWS, 12) and imus.shape == (ROWS, 4, 3)
    np.testing.assert_array_equal(poses[:, :3] * 1e3, table[["x_mm", "y_mm", "z_mm"]])
    angles = np.degrees(springtwin.ypr_rad(poses[:, 3:]))
    np.testing.assert_allclose(angles, table[["yaw_deg", "pitch_deg", "roll_deg"]], atol=1e-9)
    np.testing.assert_array_equal(springs * 1e3, table[[f"spring{i}_mm" for i in range(1, 13)]])
    names = [f"imu{i}_{a}_deg" for i in range(1, 5) for a in ("yaw", "pitch", "roll")]
    np.testing.assert_allclose(np.degrees(imus.reshape(ROWS, 12)), table[names], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1)


def test_the_mesh_equals_the_command(program: Program, robot: Robot) -> None:
    kpa = [20, -10, 0, 5, 0, -15]
    words = ",".join(map(str, kpa))
    solved = program("sim", "solve", f"--pressures={words}", "--simulator", "mesh")
    mesh = robot.solve(np.array(kpa) * 1e3, simulator="mesh")
    np.testing.assert_allclose(mesh.position_m * 1e3, solved["tip_mm"], rtol=1e-12)
    rod = robot.solve(np.array(kpa) * 1e3)
    assert 1e-6 < np.linalg.norm(mesh.position_m - rod.position_m) < 5e-3


def test_one_case_has_no_row_of_its_own_and_equals_that_of_many(robot: Robot) -> None:
    pressures = robot.sample(30, seed=2)
    many = robot.solve(pressures, 0.1, [0, 0, -1])
    one = robot.solve(pressures[7], 0.1, [0, 0, -1])
    assert one.poses.shape == (7,) and one.imus_ypr_rad.shape == (4, 3)
    for a, b in zip(many, one, strict=True):
        np.testing.assert_array_equal(a[7], b)
    loads = robot.solve(pressures[7], [0.0, 0.1, 0.2], [0, 0, -1])
    np.testing.assert_array_equal(loads.poses[1], one.poses)
    assert robot.solve(np.zeros((0, 6))).poses.shape == (0, 7)
    assert bool(one.solved) and many.solved.all()


def test_any_memory_order_and_type_of_numbers_is_taken(robot: Robot) -> None:
    pressures = np.round(robot.sample(10))
    wanted = robot.solve(pressures).poses
    for other in (np.asfortranarray(pressures), pressures.astype(np.int64), pressures.tolist()):
        np.testing.assert_array_equal(robot.solve(other).poses, wanted)


def test_the_jacobian_is_that_of_finite_differences(robot: Robot) -> None:
    at, payload, force = robot.sample(5, seed=9) * 0.7, 0.1, np.array([0.2, -0.1, 0.3])
    j = robot.jacobian(at, payload, force)
    assert j.tip.shape == (5, 6, 10) and j.springs_m.shape == (5, 12, 10)

    def moved(column: int, by: float) -> springtwin.Solved:
        p, m, f = at.copy(), payload, force.copy()
        if column < 6:
            p[:, column] += by
        elif column == 6:
            m += by
        else:
            f[column - 7] += by
        return robot.solve(p, m, f)

    for column in range(10):
        h = 10.0 if column < 6 else 1e-3
        up, down = moved(column, h), moved(column, -h)
        tip = (up.position_m - down.position_m) / (2 * h)
        np.testing.assert_allclose(j.tip[:, :3, column], tip, rtol=1e-4, atol=1e-9 / h)
        springs = (up.springs_m - down.springs_m) / (2 * h)
        np.testing.assert_allclose(j.springs_m[:, :, column], springs, rtol=1e-4, atol=1e-9 / h)
        # The rotation from one to the other is twice the imaginary part of q_up * conj(q_down).
        a, b = up.quaternion_wxyz, down.quaternion_wxyz
        turn = b[:, :1] * a[:, 1:] - a[:, :1] * b[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
        np.testing.assert_allclose(j.tip[:, 3:, column], 2 * turn / (2 * h), rtol=1e-4, atol=1e-8 / h)


def test_samples_are_those_of_the_data_set(program: Program, robot: Robot, tmp_path: Path) -> None:
    out = tmp_path / "data.parquet"
    program("dataset", "generate", "--samples", 40, "--seed", 5, "--out", out)
    table = pd.read_parquet(out)
    pressures = robot.sample(40, seed=5)
    named = [c for c in table.columns if c.startswith("p") and c.endswith(("_pa", "_kpa"))][:6]
    scale = 1e3 if named[0].endswith("_kpa") else 1.0
    # The data set keeps single precision.
    np.testing.assert_allclose(table[named].to_numpy() * scale, pressures, rtol=1e-6, atol=1e-2)


def test_out_of_range_is_refused_with_the_row_and_the_sentence_of_the_command(program: Program, robot: Robot) -> None:
    pressures = robot.sample(4)
    pressures[2, 3] = 99e3
    with pytest.raises(springtwin.Error, match=r"row 2: 99 kPa in chamber 4 is outside of the range of robot") as e:
        robot.solve(pressures)
    printed = program("sim", "solve", "--pressures=0,0,0,99,0,0", fails=True)
    assert str(e.value).removeprefix("row 2: ") in printed
    with pytest.raises(springtwin.Error, match="more than robot .* carries"):
        robot.solve(np.zeros(6), 50.0)
    with pytest.raises(springtwin.Error, match="not a number"):
        robot.solve(np.zeros(6), 0.0, [0, np.nan, 0])
    with pytest.raises(springtwin.Error, match="5 columns: give 6"):
        robot.solve(np.zeros((3, 5)))
    with pytest.raises(springtwin.Error, match="as many of each"):
        robot.solve(np.zeros((3, 6)), np.zeros(2))
    with pytest.raises(springtwin.Error, match="no array of numbers"):
        robot.solve("six")  # type: ignore[arg-type]
    with pytest.raises(springtwin.Error, match="there is no simulator"):
        robot.solve(np.zeros(6), simulator="beam")  # type: ignore[arg-type]


def test_a_case_without_equilibrium_is_an_error_that_names_its_row_or_nan(robot: Robot) -> None:
    force = np.zeros((12, 3))
    force[10] = [0, 0, 5e4]
    with pytest.raises(springtwin.Error, match="^row 10: "):
        robot.solve(np.zeros(6), 0.0, force)
    solved = robot.solve(np.zeros(6), 0.0, force, unsolved="nan")
    assert solved.solved.tolist() == [n != 10 for n in range(12)]
    assert np.isnan(solved.springs_m[10]).all() and np.isfinite(solved.springs_m[9]).all()


def test_other_threads_run_meanwhile(robot: Robot) -> None:
    pressures = robot.sample(4000, seed=1)
    took: list[float] = []

    def work() -> None:
        start = time.perf_counter()
        robot.solve(pressures)
        took.append(time.perf_counter() - start)

    thread = threading.Thread(target=work)
    thread.start()
    longest, last = 0.0, time.perf_counter()
    while thread.is_alive():
        now = time.perf_counter()
        longest, last = max(longest, now - last), now
    assert longest < 0.5 * took[0], f"{longest} s of {took[0]} s"


def test_a_robot_goes_to_other_processes(robot: Robot) -> None:
    other = Robot(ROOT / "assets" / "robots" / "asu-arm.toml")
    for sent in [robot, other]:
        taken = pickle.loads(pickle.dumps(sent))
        assert taken.text == sent.text and taken.hash == sent.hash
    rows = robot.sample(4, seed=3)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        there = pool.submit(robot.solve, rows).result()
    assert np.array_equal(there.poses, robot.solve(rows).poses)
    with pytest.raises(springtwin.Error, match="line 1, column 8"):
        Robot.from_text("name = 3\n")


def test_robot_files(robot: Robot, tmp_path: Path) -> None:
    other = Robot(ROOT / "assets" / "robots" / "asu-arm.toml")
    assert other.name != robot.name and other.hash != robot.hash
    assert robot.pressure_range_pa[0] < 0 < robot.pressure_range_pa[1]
    assert robot.pressure_rate_pa_s > 0 and robot.payload_max_kg > 0 and robot.patches == []
    robot.save(tmp_path / "robot.toml")
    assert Robot(tmp_path / "robot.toml").hash == robot.hash
    with pytest.raises(springtwin.Error, match="exists already.*overwrite=True"):
        robot.save(tmp_path / "robot.toml")
    (tmp_path / "bad.toml").write_text("name = 3\n")
    with pytest.raises(springtwin.Error, match=r"bad\.toml: "):
        Robot(tmp_path / "bad.toml")
    with pytest.raises(springtwin.Error, match=r"none\.toml"):
        Robot(tmp_path / "none.toml")

"""The environments: gymnasium's own checks, seeds, vectors, and that they can be solved."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from springtwin.envs import ReachEnv, TrackEnv

IDS = ["springtwin/Reach-v0", "springtwin/Track-v0"]


@pytest.mark.parametrize("id", IDS)
def test_gymnasium_accepts_it(id: str) -> None:
    env = gymnasium.make(id)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


@pytest.mark.parametrize("id", IDS)
def test_a_seed_determines_an_episode(id: str) -> None:
    def episode(seed: int) -> list[float]:
        env = gymnasium.make(id)
        env.action_space.seed(seed)
        observation, _ = env.reset(seed=seed)
        out = [float(x) for part in observation.values() for x in part]
        for _ in range(5):
            observation, reward, _, _, _ = env.step(env.action_space.sample())
            out += [float(reward)] + [float(x) for part in observation.values() for x in part]
        return out

    assert episode(3) == episode(3)
    assert episode(3) != episode(4)


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("mode", ["sync", "async"])
def test_it_is_vectorised(id: str, mode: str) -> None:
    envs = gymnasium.make_vec(id, num_envs=2, vectorization_mode=mode)
    first, _ = envs.reset(seed=5)
    observation, reward, _, _, info = envs.step(envs.action_space.sample())
    assert observation["springs_m"].shape == (2, 12) and reward.shape == (2,)
    assert not np.array_equal(first["target_m"][0], first["target_m"][1])
    assert info["distance_m"].shape == (2,)
    envs.close()


def test_the_truth_is_in_no_observation() -> None:
    env = ReachEnv()
    assert isinstance(env.observation_space, gymnasium.spaces.Dict)
    assert set(env.observation_space.spaces) == {"springs_m", "imus_ypr_rad", "pressures_pa", "set_pa", "target_m"}
    assert "velocity_m_s" in TrackEnv().observation_space.spaces  # type: ignore[attr-defined]


def test_an_episode_ends_after_its_steps() -> None:
    env = gymnasium.make(IDS[0])
    env.reset(seed=1)
    done = [env.step(np.zeros(6, np.float32))[2:4] for _ in range(150)]
    assert not any(terminated for terminated, _ in done)
    assert [truncated for _, truncated in done] == [False] * 149 + [True]


def test_a_policy_that_sees_the_observation_alone_reaches_the_target() -> None:
    """Steers the springs, by the model's Jacobian, to the lengths that they have in the model with the tip at the target."""
    env = ReachEnv()
    robot, target = env.robot, np.array([0.05, 0.03, -0.31])
    wanted = np.zeros(6)
    for _ in range(10):
        off = target - robot.solve(wanted).position_m
        wanted += np.linalg.pinv(robot.jacobian(wanted).tip[:3, :6]) @ off
    springs_m = robot.solve(wanted).springs_m
    inverse = np.linalg.pinv(robot.jacobian(wanted).springs_m[:, :6])
    observation, info = env.reset(seed=2, options={"target_m": target})
    start_m = info["distance_m"]
    for _ in range(150):
        # From the measured pressures on: the pumps are slower than the set pressures.
        wanted_pa = observation["pressures_pa"] + inverse @ (springs_m - observation["springs_m"])
        change_pa = wanted_pa - observation["set_pa"]
        action = np.clip(change_pa / (robot.pressure_rate_pa_s * 0.1), -1, 1)
        observation, reward, _, _, info = env.step(action.astype(np.float32))
        assert reward == pytest.approx(-info["distance_m"] * 1e3 / 10)
    assert info["distance_m"] < 2e-3 and start_m > 50e-3

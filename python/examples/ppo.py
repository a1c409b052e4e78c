"""PPO on the virtual rig (simulated): pip install "./python[gym]" stable-baselines3, then python python/examples/ppo.py [STEPS]."""

import sys

import springtwin  # registers the environments
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

print(f"springtwin {springtwin.__version__}")
# Observations are in SI units: networks want them scaled.
envs = VecNormalize(make_vec_env("springtwin/Reach-v0", n_envs=4, seed=1), norm_reward=False)
model = PPO("MultiInputPolicy", envs, n_steps=512, seed=1)
for what, steps in [("before", 0), ("after", int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)]:
    model.learn(steps) if steps else None
    mean, sd = evaluate_policy(model, envs, n_eval_episodes=8)
    print(f"{what} {steps} steps: return {mean:.0f} +- {sd:.0f} (150 steps of minus the distance in cm)")

#!/usr/bin/env bash
# Gymnasium 1.4.0: NormalizeReward carries its return over truncated episodes, so rewards are scaled by the way an episode ends.
# Source: found by comparing with Stable-Baselines3's VecNormalize, which starts anew at every end, run on 2026-11-29. Remedy: VecNormalize.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check torch==2.13.0 stable_baselines3==2.9.2 gymnasium==1.4.0 numpy==2.4.6 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import gymnasium
import numpy as np
import stable_baselines3
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

GAMMA, STEPS = 0.99, 5000


class Picks(gymnasium.Env):
    """Five attempts with reward 1 each; the episode ends terminated or truncated."""

    observation_space = spaces.Box(-1, 1, (1,))
    action_space = spaces.Discrete(2)

    def __init__(self, end):
        self.end = end

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.count += 1
        over = self.count == 5
        return np.zeros(1, np.float32), 1.0, over and self.end == "terminated", over and self.end == "truncated", {}


def gymnasium_reward(end):
    env = gymnasium.wrappers.NormalizeReward(Picks(end), gamma=GAMMA)
    env.reset(seed=0)
    for _ in range(STEPS):
        _, reward, terminated, truncated, _ = env.step(0)
        if terminated or truncated:
            env.reset()
    return float(reward)


def baselines_reward(end):
    env = VecNormalize(DummyVecEnv([lambda: Picks(end)]), gamma=GAMMA, norm_obs=False)
    env.reset()
    for _ in range(STEPS):
        _, reward, _, _ = env.step(np.zeros(1, int))
    return float(reward[0])


print(f"Gymnasium {gymnasium.__version__}, Stable-Baselines3 {stable_baselines3.__version__}, NumPy {np.__version__}; first seen 2026-11-29")
print("one would expect: five rewards of 1 an episode are scaled alike by both libraries, whether the episode terminates or is truncated,")
print("                  since reset() is called after either")
ours = {end: gymnasium_reward(end) for end in ("terminated", "truncated")}
theirs = {end: baselines_reward(end) for end in ("terminated", "truncated")}
print(f"what happens:     a reward of 1 after {STEPS} steps (gamma {GAMMA})")
for end in ours:
    print(f"                  episodes {end}: NormalizeReward {ours[end]:.3f}, VecNormalize {theirs[end]:.3f}")
print("so:               with a time limit the running return nears 1 / (1 - gamma) over episodes of five steps, and rewards come out seven times smaller")
assert abs(theirs["terminated"] - theirs["truncated"]) < 1e-6, "VecNormalize should not care how an episode ends"
assert abs(ours["terminated"] / theirs["terminated"] - 1) < 0.05 and ours["truncated"] < 0.2 * ours["terminated"], "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py"

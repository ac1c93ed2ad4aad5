"""Step the shipped policy through the Gymnasium environment (extra: env).

python examples/gymnasium_env.py [ROBOT]
"""

import sys

import numpy as np

import mimic


def main(robot: str = "cyberdog2", seconds: str = "10") -> None:
    env = mimic.Env(robot, seconds=float(seconds))
    policy = mimic.load_policy(robot=env.description)
    seen, _ = env.reset(seed=1)
    rewards, errors = [], []
    over = False
    while not over:
        seen, reward, fell, ended, info = env.step(policy.act(seen))
        over = fell or ended
        rewards.append(reward)
        if info["phase"] == "track":
            errors.append(info["toe_error"].mean())
    print(f"{len(rewards)} steps, fell: {fell}, reward {np.mean(rewards):.2f} a step, ", end="")
    print(f"toe error {100 * np.mean(errors):.1f} cm")


if __name__ == "__main__":
    main(*sys.argv[1:])

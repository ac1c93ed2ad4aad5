"""Control steps per second of training, split into physics, rewards and observations, inference, and learning.

python benchmarks/training_speed.py [name=value ...]          # settings as in python -m mimic.train
python benchmarks/training_speed.py --physics                 # physics alone, several solver settings
"""

from __future__ import annotations

import dataclasses
import sys
import time

import torch

from mimic.robot.description import load_description
from mimic.settings import LearnSettings, MdpSettings
from mimic.train.environment import StandTrackEnv
from mimic.train.overrides import with_overrides
from mimic.train.worlds import Worlds

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
REPEATS = 60 if DEVICE == "cuda" else 3


def wait() -> None:
    if DEVICE == "cuda":
        torch.cuda.synchronize()


def timed(function, repeats: int = REPEATS) -> float:
    """Return the mean time of a call [s], after three calls that do not count."""
    for _ in range(3):
        function()
    wait()
    begin = time.perf_counter()
    for _ in range(repeats):
        function()
    wait()
    return (time.perf_counter() - begin) / repeats


def physics(settings: MdpSettings) -> float:
    """Return control steps per second of the physics alone, robots shaking around their stand."""
    description = load_description()
    worlds = Worlds(description, settings, DEVICE, 0)
    pose = torch.as_tensor(description.poses["four"], dtype=torch.float32, device=DEVICE)
    noise = 0.3 * torch.randn(16, 1, settings.worlds, 12, device=DEVICE)
    state = {"i": 0}

    def step() -> None:
        worlds.substep_ctrl.copy_((pose + noise[state["i"] % 16]).expand_as(worlds.substep_ctrl))
        state["i"] += 1
        worlds.step()

    return settings.worlds / timed(step)


def whole(mdp: MdpSettings, learn: LearnSettings) -> dict[str, float]:
    """Return the time of each part of a control step [ms] and the steps per second of the whole loop."""
    import contextlib
    import io

    from rsl_rl.runners import OnPolicyRunner

    from mimic.train.learn import runner_config

    env = StandTrackEnv(load_description(), mdp, DEVICE, learn.seed)
    with contextlib.redirect_stdout(io.StringIO()):
        runner = OnPolicyRunner(env, runner_config(learn), None, DEVICE)
    with torch.inference_mode():
        observation = env.get_observations()
        inference = timed(lambda: runner.alg.act(observation))
        action = runner.alg.act(observation)
        step = timed(lambda: env.step(action))
        alone = timed(env.worlds.step)
    loop: list[float] = []

    class Stop(Exception):
        pass

    def log(**figures: float) -> None:
        loop.append(figures["collect_time"] + figures["learn_time"])
        if len(loop) >= 8:
            raise Stop

    runner.logger.log = log  # type: ignore[method-assign]
    with contextlib.suppress(Stop), contextlib.redirect_stdout(io.StringIO()):
        runner.learn(100)
    iteration = sorted(loop)[len(loop) // 2]
    steps = mdp.worlds * learn.steps
    return {
        "physics_ms": 1e3 * alone,
        "rewards_observation_ms": 1e3 * (step - alone),
        "inference_ms": 1e3 * inference,
        "learning_ms_per_step": 1e3 * (iteration / learn.steps - step - inference),
        "steps_per_s": steps / iteration,
    }


def main() -> None:
    words = sys.argv[1:]
    if "--physics" in words:
        base, _ = with_overrides(MdpSettings(), LearnSettings(), [w for w in words if w != "--physics"])
        for iterations, search in ((6, 8), (4, 6), (3, 5), (2, 4), (10, 20)):
            s = dataclasses.replace(base, solver_iterations=iterations, linesearch_iterations=search)
            print(f"worlds {s.worlds} newton {iterations} line search {search}: {physics(s) / 1e6:.2f} M/s", flush=True)
        big = dataclasses.replace(base, worlds=2 * base.worlds)
        print(f"worlds {big.worlds} newton {big.solver_iterations}: {physics(big) / 1e6:.2f} M/s", flush=True)
        return
    mdp, learn = with_overrides(MdpSettings(), LearnSettings(), words)
    for name, value in whole(mdp, learn).items():
        print(f"{name:>24} {value:,.3f}", flush=True)


if __name__ == "__main__":
    main()

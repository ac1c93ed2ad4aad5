"""The stages of training_speed.py, one a process: training_stages.py STAGE [name=value ...]; the last line is JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import itertools
import json
import subprocess
import sys
import tempfile
import time
import traceback
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from rsl_rl.runners import OnPolicyRunner

from mimic.config.training import LearnSettings, MdpSettings
from mimic.robot.description import load_description
from mimic.train.learn import runner_config, train
from mimic.train.overrides import with_overrides
from mimic.train.stand_track import StandTrackEnv
from mimic.train.worlds import Worlds

ON_GPU = torch.cuda.is_available()
DEVICE = "cuda" if ON_GPU else "cpu"
SMALL, LARGE = (8192, 16384) if ON_GPU else (8, 16)
UPDATES = 100 if ON_GPU else 2
"""Of the trainings whose rewards are compared."""

Figures = dict[str, Any]
Settings = tuple[MdpSettings, LearnSettings]

LEAN = {"rows": 64, "contacts": 8}
PHYSICS: dict[str, dict[str, Any]] = {
    "dense, 96 rows, 20 contacts": {"rows": 96, "contacts": 20},
    "dense, 64 rows, 8 contacts": LEAN,
    "dense, 64 rows, 8 contacts, 20 iterations": {**LEAN, "solver_iterations": 20},
    "dense, 64 rows, 8 contacts, 5 iterations": {**LEAN, "solver_iterations": 5},
    "dense, 64 rows, 8 contacts, two halves at once": {**LEAN, "parts": 2},
    "dense, 64 rows, 8 contacts, Hessian by 32": {**LEAN, "blocks": {"update_gradient_JTDAJ_dense": 32}},
    "dense, 64 rows, 8 contacts, Hessian by 64": {**LEAN, "blocks": {"update_gradient_JTDAJ_dense": 64}},
    "dense, 64 rows, 8 contacts, Cholesky by 32": {**LEAN, "blocks": {"update_gradient_cholesky": 32}},
    "dense, 64 rows, 8 contacts, warm starts alone": {**LEAN, "smooth": False},
    "dense, 64 rows, 8 contacts, unrolled": {**LEAN, "unrolled": True},
    "dense, 64 rows, 8 contacts, 12 line searches": {**LEAN, "linesearch_iterations": 12},
    "dense, 64 rows, 8 contacts, 4 iterations": {**LEAN, "solver_iterations": 4},
    "dense, 64 rows, 8 contacts, tolerance 1e-5": {**LEAN, "tolerance": 1e-5},
    "dense, 64 rows, 8 contacts, tolerance 1e-4": {**LEAN, "tolerance": 1e-4},
    "dense, 64 rows, 8 contacts, Euler": {**LEAN, "integrator": "EULER"},
    "dense, 64 rows, 8 contacts, integrator of 4.0": {**LEAN, "integrator": "DISCRETE"},
    "dense, 64 rows, 8 contacts, pyramidal cones": {**LEAN, "cone": "PYRAMIDAL"},
    "dense, 64 rows, 8 contacts, line search by 64": {**LEAN, "blocks": {"linesearch_iterative": 64}},
    "dense, 64 rows, 8 contacts, gradient by 64": {**LEAN, "blocks": {"update_gradient_grad": 64}},
}
"""Variants of the physics; the last ones first to go when time is short."""

CHANGES = ("unrolled", "smooth", "parts", "blocks", "tolerance", "integrator", "cone")
"""What of a variant is no setting of a training."""


def say(text: str) -> None:
    print(text, flush=True)


def wait() -> None:
    if ON_GPU:
        torch.cuda.synchronize()


def timed(function: Callable[[], object], repeats: int = 60 if ON_GPU else 2) -> float:
    """Return the mean time of a call [ms], after three calls that do not count."""
    for _ in range(3):
        function()
    wait()
    begin = time.perf_counter()
    for _ in range(repeats):
        function()
    wait()
    return 1e3 * (time.perf_counter() - begin) / repeats


def flailing(mdp: MdpSettings, steps: int = 50 if ON_GPU else 2) -> StandTrackEnv:
    """Return an environment in the middle of what an untrained policy does."""
    env = StandTrackEnv(load_description(), mdp, DEVICE, 1)
    with torch.inference_mode():
        for _ in range(steps):
            env.step(torch.randn(mdp.worlds, 12, device=DEVICE))
    return env


# ---------------------------------------------------------------------- physics


def physics(
    env: StandTrackEnv,
    mdp: MdpSettings,
    *,
    unrolled: bool = False,
    smooth: bool = True,
    parts: int = 1,
    blocks: dict[str, int] | None = None,
    tolerance: float | None = None,
    integrator: str | None = None,
    cone: str | None = None,
) -> float:
    """Return the time of a control step of the physics alone [ms], from where the environment is, flailing on.

    Args:
        env: Gives the state of every world.
        mdp: Settings of the physics.
        unrolled: All iterations of the solver always, without a condition in the graph.
        smooth: Compute the unconstrained acceleration too.
        parts: The worlds in this many groups, which step at the same time.
        blocks: Threads a block of some kernels.
        tolerance: Of the solver; None keeps it.
        integrator: Name of one of MuJoCo Warp's; None keeps the model's.
        cone: Likewise of the friction cones.
    """
    import mujoco_warp as mjw

    each = mdp.worlds // parts
    groups = [Worlds(load_description(), dataclasses.replace(mdp, worlds=each), DEVICE, 1 + i) for i in range(parts)]
    pose = torch.as_tensor(load_description().poses["upright"], dtype=torch.float32, device=DEVICE)
    commands = pose + 0.5 * torch.randn(16, 1, each, 12, device=DEVICE)
    for i, worlds in enumerate(groups):
        worlds.model.opt.graph_conditional = not unrolled
        worlds.model.opt.run_qacc_smooth = smooth
        if tolerance is not None:
            worlds.model.opt.tolerance.fill_(tolerance)
        if integrator is not None:
            worlds.model.opt.integrator = mjw.IntegratorType[integrator]
        if cone is not None:
            worlds.model.opt.cone = mjw.ConeType[cone]
        for name, size in (blocks or {}).items():
            setattr(worlds.model.block_dim, name, size)
        for name in ("qpos", "qvel", "warmstart"):
            getattr(worlds, name).copy_(getattr(env.worlds, name)[i * each : (i + 1) * each])
    streams = [torch.cuda.Stream() for _ in groups] if ON_GPU and parts > 1 else None
    count = itertools.count()

    def step() -> None:
        command = commands[next(count) % 16]
        for i, worlds in enumerate(groups):
            if streams:
                streams[i].wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(streams[i]) if streams else contextlib.nullcontext():
                worlds.substep_ctrl.copy_(command.expand_as(worlds.substep_ctrl))
                worlds.step()
        for stream in streams or []:
            torch.cuda.current_stream().wait_stream(stream)

    step()
    return timed(step)


def physics_stage(settings: Settings, worlds: int, variants: list[str]) -> Figures:
    mdp = dataclasses.replace(settings[0], worlds=worlds)
    env = flailing(mdp)
    found: Figures = {}
    for name in variants:
        words = dict(PHYSICS[name])
        how = {k: words.pop(k) for k in CHANGES if k in words}
        try:
            ms = physics(env, dataclasses.replace(mdp, **words), **how)
        except Exception:
            say(f"  {name}:\n{traceback.format_exc()}")
            continue
        found[name] = {"ms": ms, "control_steps_per_s": 1e3 * worlds / ms}
        say(f"  {worlds} worlds, {name}: {ms:.2f} ms, {worlds / ms / 1e3:.2f} M/s")
    return found


def kernels_stage(settings: Settings) -> Figures:
    """Time of each kernel of the physics in a control step, launched one by one."""
    import warp as wp

    mdp = dataclasses.replace(settings[0], worlds=SMALL)
    env = flailing(mdp)
    niter = wp.to_torch(env.worlds.data.solver_niter).float()
    rows = wp.to_torch(env.worlds.data.nefc).float()
    state = {
        "mean iterations": niter.mean().item(),
        "at the limit": (niter >= mdp.solver_iterations).float().mean().item(),
        "mean rows": rows.mean().item(),
        "most rows": rows.max().item(),
        "contacts a world": env.worlds.data.nacon.numpy()[0].item() / mdp.worlds,
    }
    say("  " + ", ".join(f"{k} {v:.4g}" for k, v in state.items()))
    if not ON_GPU:
        return {"state": state}
    wp.timing_begin(cuda_filter=wp.TIMING_ALL)
    with wp.ScopedDevice(DEVICE):
        env.worlds._run()
    total: dict[str, list[float]] = defaultdict(list)
    for r in wp.timing_end():
        total[r.name].append(r.elapsed)
    order = sorted(total.items(), key=lambda item: -sum(item[1]))
    say(f"  all kernels: {sum(map(sum, total.values())):.2f} ms in {sum(map(len, total.values()))} launches")
    for name, times in order[:40]:
        say(f"  {sum(times):8.3f} ms {len(times):5d} x {1e3 * sum(times) / len(times):7.1f} us  {name[:90]}")
    return {"state": state, "kernels": {name: {"ms": sum(t), "launches": len(t)} for name, t in order}}


# ---------------------------------------------------------------------- the loop


def parts_stage(settings: Settings, worlds: int, *, fused: bool = False, **changes: Any) -> Figures:
    """Time of each part of a control step [ms]; learning is an update's share of it.

    With ``fused`` the element-wise code of the environment and the networks goes through a compiler.
    """
    mdp = dataclasses.replace(settings[0], worlds=worlds)
    learn = dataclasses.replace(settings[1], **changes)
    torch.backends.cuda.matmul.allow_tf32 = True
    env = StandTrackEnv(load_description(), mdp, DEVICE, 1)
    with contextlib.redirect_stdout(io.StringIO()):
        runner = OnPolicyRunner(env, runner_config(learn), None, DEVICE)
    alg: Any = runner.alg
    begin = time.perf_counter()
    if fused:
        backend = "inductor" if ON_GPU else "aot_eager"
        for name in ("_before_physics", "_after_physics"):
            setattr(env, name, torch.compile(getattr(env, name), backend=backend, dynamic=False, fullgraph=True))
        for model in (alg.actor, alg.critic):
            model.mlp.compile(backend=backend)
    with torch.inference_mode():
        for _ in range(50 if ON_GPU else 2):
            env.step(torch.randn(mdp.worlds, 12, device=DEVICE))
    if fused:
        say(f"  compiled in {time.perf_counter() - begin:.0f} s")
    alg.train_mode()
    rollouts, updates, losses = [], [], {}
    seen = env.get_observations()
    for _ in range(12 if ON_GPU else 4):
        wait()
        begin = time.perf_counter()
        with torch.inference_mode():
            for _ in range(learn.steps):
                seen, rewards, dones, extras = env.step(alg.act(seen))
                alg.process_env_step(seen, rewards, dones, extras)
            alg.compute_returns(seen)
        wait()
        middle = time.perf_counter()
        losses = alg.update()
        wait()
        rollouts.append(middle - begin)
        updates.append(time.perf_counter() - middle)
    rollout, update = (1e3 * sorted(times)[len(times) // 2] for times in (rollouts, updates))
    with torch.inference_mode():
        inference = timed(lambda: alg.act(seen))
        action = alg.act(seen)
        step = timed(lambda: env.step(action))
    alone = physics(env, mdp)
    found = {
        "physics_ms": alone,
        "rewards_observation_ms": step - alone,
        "inference_ms": inference,
        "rollout_ms": rollout / learn.steps,
        "learning_ms": update / learn.steps,
        "update_ms": update,
        "steps_per_s": 1e3 * worlds * learn.steps / (rollout + update),
    }
    say(f"  {worlds} worlds {changes} fused={fused}: " + " ".join(f"{k}={v:,.3f}" for k, v in found.items()))
    say(f"    losses {losses}, first updates {[round(1e3 * t, 1) for t in updates[:3]]} ms")
    if ON_GPU:
        say(f"    memory {torch.cuda.max_memory_allocated() / 2**30:.1f} GiB")
    return found


def launches_stage(settings: Settings) -> Figures:
    """Which launches a control step and an update are made of."""
    from torch.profiler import ProfilerActivity, profile

    mdp = dataclasses.replace(settings[0], worlds=SMALL)
    learn = dataclasses.replace(settings[1], captured=True)
    torch.backends.cuda.matmul.allow_tf32 = True
    env = flailing(mdp)
    with contextlib.redirect_stdout(io.StringIO()):
        runner = OnPolicyRunner(env, runner_config(learn), None, DEVICE)
    seen = env.get_observations()

    def rollout(seen: Any) -> Any:
        with torch.inference_mode():
            for _ in range(learn.steps):
                seen, rewards, dones, extras = env.step(runner.alg.act(seen))
                runner.alg.process_env_step(seen, rewards, dones, extras)
            runner.alg.compute_returns(seen)
        return seen

    for _ in range(3):
        seen = rollout(seen)
        runner.alg.update()
    found: Figures = {}
    seen = rollout(seen)
    wait()
    for name, function in (("update", runner.alg.update), ("step", lambda: env.step(runner.alg.act(seen)))):
        kinds = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if ON_GPU else [])]
        with torch.inference_mode(name == "step"), profile(activities=kinds) as p:
            function()
            wait()
        table = p.key_averages()
        rows = sorted(table, key=lambda e: -getattr(e, "self_device_time_total", 0))[:25]
        found[name] = {e.key: [e.count, getattr(e, "self_device_time_total", 0)] for e in rows}
        say(f"  {name}")
        for e in rows:
            say(f"  {getattr(e, 'self_device_time_total', 0) / 1e3:8.3f} ms {e.count:5d} x  {e.key[:100]}")
    return found


def gpus_stage(settings: Settings, words: list[str]) -> Figures:
    """Speed of a short training on one GPU and on several of this machine."""
    del settings
    found: Figures = {}
    gpus = torch.cuda.device_count()
    for count in [1, *(n for n in (2, 4, 8) if n <= gpus)]:
        with tempfile.TemporaryDirectory() as folder:
            run = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={count}"]
            run += ["-m", "mimic.train", folder, "--every", "10", "iterations=61", *words]
            done = subprocess.run(run, stderr=subprocess.PIPE, text=True, check=False)
        lines = [line for line in done.stderr.splitlines() if "elapsed_s=" in line]
        if done.returncode or len(lines) < 7:
            say("\n".join(done.stderr.splitlines()[-40:]))
            found[str(count)] = {"failed": done.stderr[-2000:]}
            continue
        steps, seconds = (
            [float(line.split(key)[1].split(end)[0]) for line in lines]
            for key, end in ((" ", "M"), ("elapsed_s=", " "))
        )
        found[str(count)] = {"steps_per_s": 1e6 * (steps[-1] - steps[2]) / (seconds[-1] - seconds[2]), "lines": lines}
        say(f"  {count} GPU(s): {found[str(count)]['steps_per_s'] / 1e6:.3f} M steps/s; {lines[-1]}")
    return found


def training_stage(settings: Settings, **changes: Any) -> Figures:
    """Rewards and speed of a short real training."""
    mdp = dataclasses.replace(settings[0], worlds=SMALL if ON_GPU else 4)
    learn = dataclasses.replace(settings[1], iterations=UPDATES, device=DEVICE, save_every=10**6, **changes)
    rows: list[dict[str, float]] = []

    def report(update: int, row: dict[str, float]) -> None:
        rows.append({"update": update, **row})
        if update % (UPDATES // 10 or 1) == 0 or update == UPDATES - 1:
            keys = ("reward", "episode", "std", "learning_rate", "collect_s", "learn_s", "elapsed_s")
            figures = " ".join(f"{k}={row[k]:.4g}" for k in keys)
            tracked = " ".join(f"{k[6:]}={v:.3g}" for k, v in row.items() if k.startswith("track/"))
            say(f"  {update} {row['steps'] / 1e6:.1f}M {figures} {tracked}")

    with tempfile.TemporaryDirectory() as folder:
        train(Path(folder), mdp, learn, report=report)
    first, last = rows[len(rows) // 4], rows[-1]
    speed = (last["steps"] - first["steps"]) / (last["elapsed_s"] - first["elapsed_s"])
    say(f"  {changes}: {speed / 1e6:.3f} M steps/s with everything")
    return {"steps_per_s": speed, "rows": rows}


# ---------------------------------------------------------------------- stages

STAGES: dict[str, Callable[[Settings, list[str]], Figures]] = {
    "captured": lambda s, _: parts_stage(s, SMALL, captured=True),
    "kernels": lambda s, _: kernels_stage(s),
    "physics": lambda s, _: physics_stage(s, SMALL, list(PHYSICS)),
    "captured_large": lambda s, _: parts_stage(s, LARGE, captured=True),
    "physics_large": lambda s, _: physics_stage(s, LARGE, list(PHYSICS)[:3]),
    "fused": lambda s, _: parts_stage(s, SMALL, captured=True, fused=True),
    "plain": lambda s, _: parts_stage(s, SMALL, captured=False),
    "training_captured": lambda s, _: training_stage(s, captured=True),
    "training_plain": lambda s, _: training_stage(s, captured=False),
    "launches": lambda s, _: launches_stage(s),
    "gpus": gpus_stage,
}


def main() -> None:
    words = sys.argv[2:]
    figures = STAGES[sys.argv[1]](with_overrides(MdpSettings(), LearnSettings(), words), words)
    say("JSON " + json.dumps(figures))


if __name__ == "__main__":
    main()

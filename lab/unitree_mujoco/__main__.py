"""mimic --robot go2 on Unitree's own bridge and model.

python -m lab.unitree_mujoco starts N [POLICY [SIT_DOWN]]  N robots lie, stand up, box, sit down, in lockstep, with
                                                           5 % of all messages lost for the fourth second
python -m lab.unitree_mujoco network                       over DDS: a robot passes pre-flight, and with a second
                                                           writer of Unitree's SDK it is refused
python -m lab.unitree_mujoco checksum                      ours against Unitree's, for random messages
python -m lab.unitree_mujoco serve DOMAIN SECONDS          the simulator, over DDS
python -m lab.unitree_mujoco rival DOMAIN SECONDS          the second writer

MIMIC_UNITREE names the folder of Unitree's files; see bridge.py.
"""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from lab.in_process.sender_link import EmulatedSenderLink
from lab.unitree_mujoco.bridge import STEP, LockstepBus, NotHere, load, model_of
from mimic.config.play import RunSettings
from mimic.control.safety.supervisor import Supervisor
from mimic.control.tick import Safety
from mimic.errors import AssetError, MimicError
from mimic.flows.play import load_source, play
from mimic.hardware.go2.driver import Go2Driver
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE, blank, encode
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.robot.checks import CheckOptions, refuse
from mimic.hardware.robot.plant import Robot
from mimic.io.assets import shipped
from mimic.policy.runtime import load_policy
from mimic.records import FloatArray
from mimic.robot.description import load_description

ROOT = Path(__file__).parents[2]
BOXING = ROOT / "examples" / "videos" / "boxing.mp4"

LOSS, LOSS_FROM, LOSS_UNTIL = 0.05, 9.0, 10.0
"""Share of messages lost, and when [s]: while the robot boxes."""


ENDS = ("finished", "at_rest")
"""Rules that end a good run."""


def wiring_file(work: Path, domain: int = 1) -> Path:
    """Write the wiring of a simulator without a motion switcher."""
    text = shipped("assets", "go2", "board.toml").read_text(encoding="utf-8")
    text = re.sub(r"^motion_switcher = true", "motion_switcher = false", text, flags=re.M)
    path = work / "board.toml"
    path.write_text(re.sub(r"^domain = \d+", f"domain = {domain}", text, flags=re.M), encoding="utf-8")
    return path


def up(data: Any) -> FloatArray:
    """Return the cosine between base x and up."""
    w, x, y, z = data.qpos[3:7]
    return np.asarray(2.0 * (x * z - w * y))


def start(seed: int, work: Path, commands: Any, policy: Any, sit_down: Any, *, curve: bool) -> dict[str, Any]:
    """Let one robot lie, stand up, box and sit down; return what came of it."""
    description = load_description("go2")
    bus, rows = LockstepBus(description, seed, curve=curve), list[float]()
    bus.hook = lambda t: rows.append(float(up(bus.data)))
    bus.loss = lambda t: LOSS if LOSS_FROM <= t < LOSS_UNTIL else 0.0
    link = EmulatedSenderLink(Go2Driver(bus, load_go2(wiring_file(work)), description), description)
    bus.listen(1.0)
    robot = Robot(link, description)
    try:
        refuse(link.checks(CheckOptions(rate_hz=50.0)))
        safety = Safety(supervisor=Supervisor(description), ramp=2.0)
        done = play(commands, plant=robot, policy=policy, sit_down=sit_down, settings=RunSettings(), safety=safety)
    except MimicError as reason:
        return {"seed": seed, "stood": False, "line": str(reason)}
    finally:
        robot.close()
    last = bus.last.motor_cmd[:12]
    stood = np.array(rows)
    return {
        "seed": seed,
        "stood": done.shortfall is None,
        "upright_s": round(float(np.count_nonzero(stood > 0.85) * STEP), 1),
        "toe_error_cm": (done.metrics["toe_error_cm"] or {}).get("mean"),
        "lies": bool(abs(stood[-1]) < 0.3 and bus.data.qpos[2] < 0.2),
        "damped_last": max(one.kp for one in last) == 0.0 and min(one.kd for one in last) > 0.0,
        "ending": robot.ending,
        "rules": [event.text for event in done.events if event.mode > 0 and event.rule not in ENDS],
    }


def starts(count: int, names: list[str], *, curve: bool = False) -> list[dict[str, Any]]:
    """Play the boxing clip on robots that lie differently."""
    description = load_description("go2")
    policy = load_policy(names[0] if names else None, description)
    sit_down = load_policy(names[1], description, task="sit_down") if names[1:] else None  # None: the shipped one
    commands = load_source(BOXING, None, None, description).commands
    with tempfile.TemporaryDirectory() as work:
        rows = []
        for seed in range(count):
            rows.append(start(seed, Path(work), commands, policy, sit_down, curve=curve))
            print(json.dumps(rows[-1]), flush=True)
    return rows


def checksum(count: int = 200) -> int:
    """Return how many of some random messages have other bytes or another checksum than the SDK's."""
    load()
    from unitree_sdk2py.idl.unitree_go.msg.dds_ import LowCmd_, LowState_  # type: ignore[import-not-found]
    from unitree_sdk2py.utils.crc import CRC  # type: ignore[import-not-found]

    rng, wrong = np.random.default_rng(0), 0
    for number in range(count):
        topic, kind, motors = (LOWCMD, LowCmd_, "motor_cmd") if number % 2 else (LOWSTATE, LowState_, "motor_state")
        message = blank(topic)
        message[motors]["q"], message[motors]["dq"] = rng.normal(size=(2, 20))
        message[motors]["mode"] = rng.integers(0, 2, 20)
        wire = encode(topic, message)
        theirs = kind.deserialize(wire)
        wrong += theirs.serialize() != wire or CRC().Crc(theirs) != int(message["crc"])
    return wrong


def serve(domain: int, seconds: float) -> None:
    """Run Unitree's bridge over DDS as its own program does, without its window."""
    bridge = load()
    from unitree_sdk2py.core.channel import ChannelFactoryInitialize  # type: ignore[import-not-found]

    model, data = model_of(load_description("go2"), 0)
    ChannelFactoryInitialize(domain, "lo")
    robot = bridge.UnitreeSdk2Bridge(model, data)
    print("ready", flush=True)
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        mujoco.mj_step(model, data)
        time.sleep(max(begin + data.time - time.monotonic(), 0.0))
    del robot
    os._exit(0)  # its threads have no end


def rival(domain: int, seconds: float) -> None:
    """Send empty commands with Unitree's SDK, as another program would."""
    load()
    from unitree_sdk2py.core.channel import (  # type: ignore[import-not-found]
        ChannelFactoryInitialize,
        ChannelPublisher,
    )
    from unitree_sdk2py.idl.default import unitree_go_msg_dds__LowCmd_  # type: ignore[import-not-found]
    from unitree_sdk2py.idl.unitree_go.msg.dds_ import LowCmd_  # type: ignore[import-not-found]

    ChannelFactoryInitialize(domain, "lo")
    publisher = ChannelPublisher("rt/lowcmd", LowCmd_)
    publisher.Init()
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        publisher.Write(unitree_go_msg_dds__LowCmd_())
        time.sleep(0.02)


def network() -> dict[str, Any]:
    """Check a robot over DDS: alone, and beside a second writer."""
    domain = random.SystemRandom().randrange(1, 200)
    me = [sys.executable, "-m", "lab.unitree_mujoco"]
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as work:
        wiring = wiring_file(Path(work), domain)
        check = [sys.executable, "-m", "mimic", "robot", "check", "go2", "--interface", "lo", "--wiring", str(wiring)]
        served = subprocess.Popen([*me, "serve", str(domain), "120"], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        try:
            assert served.stdout is not None
            served.stdout.readline()
            for name in ("alone", "beside another program"):
                other = subprocess.Popen([*me, "rival", str(domain), "60"], cwd=ROOT) if name != "alone" else None
                time.sleep(0.0 if other is None else 6.0)
                done = subprocess.run(
                    check, cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ | {"COLUMNS": "250"}
                )
                found[name] = {"status": done.returncode, "said": done.stdout.splitlines()}
                if other is not None:
                    other.kill()
        finally:
            served.kill()
    return found


def main(arguments: list[str]) -> int:
    """Do what the first argument says."""
    what, *more = arguments or [""]
    try:
        if what in ("starts", "curve") and more:
            rows = starts(int(more[0]), more[1:], curve=what == "curve")
            good = sum(row["stood"] and row["lies"] and row["damped_last"] and not row["rules"] for row in rows)
            print(f"{good} of {len(rows)}")
        elif what == "network":
            print(json.dumps(network(), indent=1))
        elif what == "checksum":
            print(f"{checksum()} messages differ")
        elif what in ("serve", "rival") and len(more) == 2:
            (serve if what == "serve" else rival)(int(more[0]), float(more[1]))
        else:
            print(__doc__)
            return 2
    except (NotHere, AssetError) as reason:
        print(reason)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

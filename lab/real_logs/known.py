"""Calibrations of shared logs, each with what is known of it.

    python -m lab.real_logs.known DATA OUT [SET ...] [--only NAME]

reads DATA/arm, arm2, xl330, emps, sts3250 and go2_air_chirp, and if asked for DATA/ur10e (ur-20_01_22-joint_1.csv of
shamilmamedov/dynamic_calibration), writes a line of JSON for each case to OUT and prints a table. A case is right if
the names, and the joints where they are known, are those hidden; where nothing of the catalogue is hidden, if what was
found does not claim to explain the log.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from lab.real_logs.logs import (
    EMPS_MJCF,
    SERVO_MJCF,
    XL330_MJCF,
    divided,
    emps_log,
    go2_log,
    identify,
    read_emps,
    servo_logs,
    xl330_logs,
)
from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel, as_logged, read_machine
from mimic.io.joint_log import JointLog, read_log
from mimic.sysid.calibrate import calibrate
from mimic.sysid.log.checks import check_log
from mimic.sysid.predict import predict
from mimic.sysid.result import Calibration, Errors

BOTH, ELBOW, SHOULDER, ANY = ("shoulder", "elbow"), ("elbow",), ("shoulder",), None

Hidden = Mapping[str, tuple[str, ...] | None]
"""Effects with their joints, None where these are not said."""

HIDDEN: Mapping[str, tuple[Hidden, ...]] = {
    "async_tlimit_216": ({"torque_speed": BOTH},),
    "async_belt_215": ({"compliance": ELBOW},),
    "async_backlash_214": ({"backlash": ELBOW},),
    "async_ecc_220": ({"encoder_eccentricity": ANY},),
    "async_heat_224": ({"kt_heat": BOTH},),
    "sync_other_boucwen_241": (),
    "async_other_tgtfilter_247": ({"target_filter": BOTH},),
    "sync_asym_212": ({"asymmetric_friction": BOTH},),
    "async_stribeck_411": ({"stribeck": BOTH},),
    "async_belt_415": ({"compliance": ELBOW},),
    "sync_backlash_414": ({"backlash": ELBOW},),
    "sync_pair_belt_cog_438": ({"compliance": ELBOW, "cogging": BOTH},),
    "sync_heat_424": ({"kt_heat": BOTH},),
    "async_tlag_434": ({"torque_lag": BOTH},),
    "sync_sag_423": ({"supply_sag": ANY, "torque_speed": BOTH}, {"supply_sag": ANY}),
    "async_tlimit_416": ({"torque_speed": BOTH},),
    "async_payload_427": ({"payload": ANY},),
    "async_pair_tspeed_asym_439": ({"torque_speed": ELBOW, "asymmetric_friction": BOTH},),
    "sync_tilt_425": ({"base_tilt": ANY}, {"encoder_offset": SHOULDER}),
    "sync_other_integral_446": (),
    "sync_other_boucwen_441": (),
}
"""What each log of the arm hides, in words of the catalogue, from the READMEs beside them; nothing where that is in no
catalogue."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Logs of a machine."""

    name: str
    machine: MachineModel
    logs: dict[str, JointLog]
    hidden: tuple[Hidden, ...] | None = None
    """What is right; None where nobody knows."""
    unseen: dict[str, JointLog] = field(default_factory=dict)
    """Logs that are predicted, not fitted."""


def cases(data: Path, sets: tuple[str, ...]) -> Iterator[Case]:
    """Yield the cases of some sets."""
    for name in sets:
        if name in ("arm", "arm2"):
            machine = read_machine(data / name / "arm.xml")
            for path in sorted((data / name).glob("*.parquet")):
                logs = {path.stem: read_log(path)}
                yield Case(name=path.stem, machine=machine, logs=logs, hidden=HIDDEN[path.stem])
        elif name == "emps":
            columns = read_emps(data / "emps" / "DATA_EMPS.parquet")
            log = emps_log(columns, identify(columns))
            yield Case(name="EMPS", machine=_machine(EMPS_MJCF), logs={"emps": log})
        elif name == "sts3250":
            logs = servo_logs(data / "sts3250")
            yield Case(name="STS3250", machine=_machine(SERVO_MJCF), logs=logs)
        elif name == "xl330":
            logs = xl330_logs(data / "xl330")
            yield Case(name="XL330", machine=_machine(XL330_MJCF), logs=logs)
        elif name == "ur10e":
            logs = {"ur10e": _ur10e_log(data / "ur10e")}
            yield Case(name="UR10e base", machine=_machine(UR10E_MJCF), logs=logs)
        elif name == "go2":
            machine = read_machine(data / "go2_air_chirp" / "go2_hung.xml")
            log = go2_log(data / "go2_air_chirp" / "log.parquet")
            for half, one in zip(("first", "second"), divided(log), strict=True):
                yield Case(name=f"Go2 {half} half", machine=machine, logs={half: one})


UR10E_MJCF = """<mujoco><worldbody><body name="arm"><inertial pos="0 0 0" mass="30" diaginertia="4 4 4"/>
<joint name="base" axis="0 0 1" damping="5" frictionloss="5" armature="0.5"/></body></worldbody>
<actuator><motor joint="base"/></actuator></mujoco>"""
"""An arm on a vertical axis, its inertia and friction as guesses."""

UR10E_GAIN = 10.0
"""Of the drive [N m/A]. Source: UR10E_parameters.txt beside the logs."""


def _ur10e_log(folder: Path) -> JointLog:
    """Return a log of the first joint by its current."""
    rows = np.loadtxt(folder / "ur-20_01_22-joint_1.csv", delimiter=",")
    source = {"source": "shamilmamedov/dynamic_calibration"}
    return JointLog(
        joints=("base",), t=rows[:, 0] - rows[0, 0], q=rows[:, 1:2], force=UR10E_GAIN * rows[:, 13:14], metadata=source
    )


def _machine(text: str) -> MachineModel:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "machine.xml"
        path.write_text(text, encoding="utf-8")
        return read_machine(path)


def right(case: Case, found: Calibration) -> bool | None:
    """Return whether what was found is what is hidden; None where nobody knows."""
    if case.hidden is None:
        return None
    said = {one.name: one.joints for one in found.found}
    if not case.hidden:
        return not (said and found.explained)
    return any(
        set(said) == set(hidden) and all(own is None or said[name] == own for name, own in hidden.items())
        for hidden in case.hidden
    )


def replayed(case: Case, found: Calibration) -> dict[str, list[float]]:
    """Return the mean absolute error of each log in one piece from its first reading, as given and with the effects."""
    errors = {}
    for name, log in (case.logs | case.unseen).items():
        machine = as_logged(case.machine, log.metadata, by_force=log.q_des is None)
        sets = (EffectSet(), found.effects)
        errors[name] = [float(np.nanmean(np.abs(predict(log, machine, one, whole=True)))) for one in sets]
    return errors


def row(case: Case, found: Calibration) -> dict[str, object]:
    """Return what was found as numbers and words."""
    scale = 1e6 if case.machine.unit == "m" else 1e3
    effects = {e.name: {k: np.round(v, 6).tolist() for k, v in e.values.items()} for e in found.effects}
    return {
        "name": case.name,
        "found": " + ".join(f"{one.name} ({', '.join(one.joints)})" for one in found.found) or "nothing",
        "right": right(case, found),
        "explained": found.explained,
        "sentence": found.sentence,
        "effects": effects,
        **{end: Errors.total(getattr(found, end).held_out) * scale for end in ("nominal", "baseline", "final")},
        "noise": Errors.total(found.noise) * scale,
        "replayed": replayed(case, found),
        "passes": found.passes,
    }


def main() -> None:
    """Run the cases and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("sets", nargs="*", default=["arm", "arm2", "xl330", "emps", "sts3250", "go2"])
    parser.add_argument("--only", default="")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    print("| log | found | right | baseline | found | noise | s |\n|---|---|---|---|---|---|---|", flush=True)
    with arguments.out.open("a", encoding="utf-8") as out:
        for case in cases(arguments.data, tuple(arguments.sets)):
            if arguments.only in case.name:
                limits = np.stack([case.machine.low, case.machine.high], -1)
                logs = [
                    check_log(log.of(case.machine.joints), limits, case.machine.unit).log for log in case.logs.values()
                ]
                began = time.process_time()
                found = calibrate(
                    logs, case.machine, CalibrateSettings(threads=arguments.threads), names=tuple(case.logs)
                )
                seconds = round(time.process_time() - began, 1)
                made = row(case, found) | {"seconds": seconds}
                out.write(json.dumps(made) + "\n")
                out.flush()
                shown = (case.name, made["found"], made["right"])
                numbers = tuple(f"{float(str(made[k])):.3g}" for k in ("baseline", "final", "noise", "seconds"))
                print("| " + " | ".join(map(str, (*shown, *numbers))) + " |", flush=True)


if __name__ == "__main__":
    main()

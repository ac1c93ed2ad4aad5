"""The identification by innovations on shared logs, each with what is known of it.

    python -m lab.real_logs.known DATA OUT [SET ...]

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
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from threadpoolctl import threadpool_limits

from mimic.sysid.engine.data import Data, data_of
from mimic.sysid.engine.laws import KEYS
from mimic.sysid.engine.model import Model
from mimic.sysid.engine.search import Outcome, describe, search
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
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog, read_log
from mimic.sysid.calibrate import OF_VOLTAGE_DRIVES

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
    data: Data
    baseline: tuple[str, ...]
    hidden: tuple[Hidden, ...] | None
    """What is right; None where nobody knows."""


def cases(data: Path, sets: tuple[str, ...]) -> Iterator[Case]:
    """Yield the cases of some sets."""
    usual = CalibrateSettings().baseline
    for name in sets:
        if name in ("arm", "arm2"):
            machine = read_machine(data / name / "arm.xml")
            for path in sorted((data / name).glob("*.parquet")):
                made = data_of([read_log(path)], machine, (path.stem,))
                yield Case(name=path.stem, data=made, baseline=usual, hidden=HIDDEN[path.stem])
        elif name == "emps":
            columns = read_emps(data / "emps" / "DATA_EMPS.parquet")
            log = emps_log(columns, identify(columns))
            yield _real("EMPS", [log], _machine(EMPS_MJCF), usual)
        elif name == "sts3250":
            yield _real("STS3250", list(servo_logs(data / "sts3250").values()), _machine(SERVO_MJCF), (*usual, "gains"))
        elif name == "xl330":
            logs = list(xl330_logs(data / "xl330").values())
            yield _real("XL330", logs, _machine(XL330_MJCF), OF_VOLTAGE_DRIVES)
        elif name == "ur10e":
            yield _real("UR10e base", [_ur10e_log(data / "ur10e")], _machine(UR10E_MJCF), usual)
        elif name == "go2":
            machine = read_machine(data / "go2_air_chirp" / "go2_hung.xml")
            for half, log in zip(
                ("first", "second"), divided(go2_log(data / "go2_air_chirp" / "log.parquet")), strict=True
            ):
                yield _real(f"Go2 {half} half", [log], machine, usual)


def _real(name: str, logs: list[JointLog], machine: MachineModel, baseline: tuple[str, ...]) -> Case:
    return Case(name=name, data=data_of(logs, machine), baseline=baseline, hidden=None)


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


def right(case: Case, outcome: Outcome) -> bool | None:
    """Return whether what was found is what is hidden; None where nobody knows."""
    if case.hidden is None:
        return None
    joints = case.data.machine.joints
    said = {name: tuple(joints[j] for j in own) for name, own in outcome.best.model.effects}
    if not case.hidden:
        return not (said and outcome.explained)
    return any(
        set(said) == set(hidden) and all(own is None or said[name] == own for name, own in hidden.items())
        for hidden in case.hidden
    )


def unseen(model: Model) -> list[float]:
    """Return the mean absolute error in whole logs of fits to the others, from where a model is, by folds."""
    data, e = model.data, np.abs(model.unseen())
    folds = [data.counts & (data.apart == k)[data.block][:, None] for k in range(int(data.apart.max()) + 1)]
    return [float(e[rows].mean()) for rows in folds]


def whole(model: Model) -> Model:
    """Return a model with the errors of plain replays of whole logs."""
    record = model.data.record
    data = replace(model.data, record=record._replace(lead=np.zeros_like(record.lead)))
    return replace(model, setting=replace(model.setting, passes=model.setting.passes.of(data))).evaluated()


def row(case: Case, outcome: Outcome) -> dict[str, object]:
    """Return what was found as numbers and words."""
    scale = 1e6 if case.data.machine.unit == "m" else 1e3
    model = outcome.best.model
    made = whole(model)
    e = np.abs(np.where(model.data.counts, np.nan_to_num(made.e), 0.0)).sum() / model.data.counts.sum()
    return {
        "name": case.name,
        "found": describe(model) + ("" if outcome.explained or not model.effects else "; the rest: unknown torque"),
        "right": right(case, outcome),
        "explained": outcome.explained,
        "ties": outcome.ties,
        "numbers": {
            f"{name}.{key}": [float(f"{v:.4g}") for v in model.table[index]]
            for index, (name, key) in enumerate(KEYS)
            if name in dict(model.effects) or name in case.baseline
        },
        "before": [round(float(x) * scale, 3) for x in outcome.before],
        "after": [round(float(x) * scale, 3) for x in outcome.after],
        "noise": [round(float(x) * scale, 3) for x in outcome.noise],
        "mean_absolute": float(e),
        "unseen": unseen(outcome.null.model) if case.data.apart.any() else [],
        "unseen_found": unseen(model) if case.data.apart.any() else [],
        "passes": outcome.passes,
        "seconds": round(outcome.seconds, 1),
    }


def main() -> None:
    """Run the cases and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("sets", nargs="*", default=["arm", "arm2", "xl330", "emps", "sts3250", "go2"])
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    print("| log | found | right | before | after | noise | s |\n|---|---|---|---|---|---|---|", flush=True)
    with threadpool_limits(1), arguments.out.open("a", encoding="utf-8") as out:
        for case in cases(arguments.data, tuple(arguments.sets)):
            if arguments.only and arguments.only not in case.name:
                continue
            began = time.perf_counter()
            made = row(case, search(case.data, case.baseline))
            made["wall"] = round(time.perf_counter() - began, 1)
            out.write(json.dumps(made) + "\n")
            out.flush()
            cells = [made[k] for k in ("name", "found", "right", "before", "after", "noise", "seconds")]
            print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()

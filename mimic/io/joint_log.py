"""Joint logs: targets and measurements of any machine with joints. The format is in docs/manual/log-format.md.

Parquet or CSV with a row for each reading: ``t`` [s], ``q.<joint>`` [rad or m], and for each joint ``q_des.<joint>``
(target of a position drive) or ``force.<joint>`` (applied force or torque); optional ``dq.<joint>`` and
``tau.<joint>``. Gains, gravity, units and notes are in the metadata of the file (key ``mimic_log``, JSON) or in a JSON
file of the same name. Other numeric columns (send and receive times, temperatures, voltages) are kept as they are.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.text_file import from_json, read_text
from mimic.errors import CalibrationError
from mimic.io.assets import manual
from mimic.io.lerobot_log import is_dataset, read_dataset
from mimic.io.reading import check_clock
from mimic.io.store import plain, written_whole
from mimic.records import BoolArray, FloatArray, IntArray

_KEY = b"mimic_log"

CHANNELS = ("q", "dq", "tau", "q_des", "force")
"""Channels that a log can have for each joint."""

UNITS = "units"
"""Metadata key: angles are in degrees, "deg", or in radians, "rad" (the default)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLog:
    """Readings of a machine over time. Arrays are (T, J); None where the log has no such channel."""

    joints: tuple[str, ...]
    t: FloatArray
    """Time of each reading (T,) [s]."""
    q: FloatArray
    """Measured position [rad or m]."""
    q_des: FloatArray | None = None
    """Target of the position drive in effect when the row was read: the one last sent [rad or m]."""
    force: FloatArray | None = None
    """Applied torque or force [N m or N]."""
    dq: FloatArray | None = None
    """Measured velocity [rad/s or m/s]."""
    tau: FloatArray | None = None
    """Measured torque of the motor at the joint [N m or N]."""
    extra: Mapping[str, FloatArray] = field(default_factory=dict)
    """Other columns of the file by name (T,), such as ``temperature.FL_knee``."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """``kp``, ``kd`` (a number, or one for each joint by name), ``gravity`` [x, y, z] in base axes [m/s^2], and free
    notes.
    """

    def __post_init__(self) -> None:
        if len(set(self.joints)) < len(self.joints):
            raise CalibrationError(f"two joints of the log have the same name: {', '.join(self.joints)}")
        for name in ("t", *CHANNELS):
            value = getattr(self, name)
            if value is None:
                continue
            value = np.array(value, dtype=np.float64)
            wanted = (len(self.t),) if name == "t" else (len(self.t), len(self.joints))
            if value.shape != wanted:
                raise CalibrationError(f"{name} of the log has shape {value.shape}, expected {wanted}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "extra", {k: np.array(v, dtype=np.float64) for k, v in self.extra.items()})

    @property
    def channels(self) -> dict[str, Any]:
        """The channels (T, J) that it has."""
        return {name: getattr(self, name) for name in CHANNELS if getattr(self, name) is not None}

    @property
    def rate(self) -> float:
        """Readings per second [Hz], gaps left out."""
        steps = np.diff(self.t)
        return float(1.0 / steps[steps < 1.5 * np.median(steps)].mean())

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.t[-1] - self.t[0])

    def part(self, rows: slice | IntArray | BoolArray) -> JointLog:
        """Return some rows."""
        cut = {name: values[rows] for name, values in self.channels.items()}
        extra = {name: column[rows] for name, column in self.extra.items()}
        return replace(self, t=self.t[rows], extra=extra, **cut)

    def of(self, joints: Sequence[str]) -> JointLog:
        """Return the log of these joints, in this order.

        Raises:
            CalibrationError: If the log lacks one.
        """
        lacking = [j for j in joints if j not in self.joints]
        if lacking:
            raise CalibrationError(
                f"the model has joint {lacking[0]!r}, but the log has {', '.join(self.joints)}; "
                "name the columns q.<joint> as the joints of the model"
            )
        index = [self.joints.index(j) for j in joints]
        picked = {name: values[:, index] for name, values in self.channels.items()}
        return replace(self, joints=tuple(joints), **picked)


def is_joint_log(path: Path) -> bool:
    """Return whether a file is a joint log in Parquet, as `write_log` writes it."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return _KEY in (pq.read_schema(path).metadata or {})
    except (pa.ArrowException, OSError):
        return False


def read_log(path: str | Path, notes: Mapping[str, Any] | None = None) -> JointLog:
    """Read a Parquet or CSV log.

    Args:
        path: The file, a run folder that holds ``joints.parquet``, or a LeRobot dataset.
        notes: Metadata that overrides that of the file and the one beside it.

    Raises:
        CalibrationError: If the file cannot be read as one; the message names what is missing.
    """
    path = Path(path)
    if not path.exists():
        raise CalibrationError(f"{path} does not exist; give a log (.parquet or .csv)")
    if path.is_dir():
        inside = path / "joints.parquet"
        if inside.exists():
            return read_log(inside, notes)
        if not is_dataset(path):
            raise CalibrationError(
                f"{path} is a folder without joints.parquet; give a log (.parquet or .csv), a run folder or a LeRobot "
                "dataset"
            )
        metadata = _said_of(path, notes)
        columns = read_dataset(path, metadata)
        metadata = {**metadata, UNITS: "rad"}
    else:
        columns, metadata = _read_csv(path) if path.suffix.lower() == ".csv" else _read_parquet(path)
        metadata = {**metadata, **_said_of(path, notes)}
    if "t" not in columns:
        raise CalibrationError(f"{path} has no column t; it has {_some(columns)}. See {manual('log-format.md')}")
    joints, found = _channels(columns, path)
    taken = {"t", *(f"{channel}.{joint}" for channel in found for joint in joints)}
    strays = sorted(n for n in columns if n not in taken and n.split(".")[0] in CHANNELS)
    if strays:
        raise CalibrationError(f"{path} has {strays[0]}, but no q.{strays[0].split('.', 1)[1]} that it belongs to")
    extra = {name: column for name, column in columns.items() if name not in taken}
    _check_gains(metadata, joints, path)
    if metadata.get(UNITS) == "deg":
        metadata = {**metadata, UNITS: "rad"}
        found |= {name: np.deg2rad(found[name]) for name in ("q", "q_des", "dq") if name in found}
    known = columns["t"][np.isfinite(columns["t"])]
    check_clock(known, path.name, CalibrationError, repeats=True)
    log = JointLog(joints=joints, t=columns["t"], metadata=metadata, extra=extra, **found)
    readings = without_marks(log)[0]
    fault = jump_fault(readings) or unit_fault(readings)
    if fault is not None:
        raise CalibrationError(f"{path.name}: {fault}")
    return log


def _said_of(path: Path, notes: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return what the file beside a log and notes say of it."""
    said: dict[str, Any] = {}
    side = path.with_suffix(".json")
    if side.exists() and side != path:
        said.update(_notes(read_text(side), f"{side} beside the log"))
    if notes:
        said.update(_notes(json.dumps(notes), f"what is said of {path}"))
    return said


def _channels(columns: Mapping[str, FloatArray], path: Path) -> tuple[tuple[str, ...], dict[str, FloatArray]]:
    """Return the joints of a log, and its channels (T, J) by name.

    Raises:
        CalibrationError: If no joint was read or moved, or a channel lacks a joint.
    """
    joints = tuple(name[2:] for name in columns if name.startswith("q."))
    if not joints:
        raise CalibrationError(
            f"{path} has no column q.<joint>; it has {_some(columns)}. See {manual('log-format.md')}"
        )
    found: dict[str, FloatArray] = {}
    for channel in CHANNELS:
        have = [j for j in joints if f"{channel}.{j}" in columns]
        if have and len(have) < len(joints):
            lacking = next(j for j in joints if j not in have)
            raise CalibrationError(
                f"{path} has {channel}.{have[0]} but no {channel}.{lacking}; give all joints or none"
            )
        if have:
            found[channel] = np.stack([columns[f"{channel}.{j}"] for j in joints], -1)
    if "q_des" not in found and "force" not in found:
        raise CalibrationError(
            f"{path} has neither q_des.<joint> nor force.<joint>: without what was asked, nothing can be replayed"
        )
    return joints, found


def without_marks(log: JointLog) -> tuple[JointLog, list[str]]:
    """Return the log without positions that stand for no reading, such as 9999, and a line for each such number.

    It occurs more than once, and no reading comes near it: it is twice as far away as all others are from each other,
    and more than two turns.
    """
    q = np.array(log.q)
    told = []
    for j, joint in enumerate(log.joints):
        values, counts = np.unique(q[np.isfinite(q[:, j]), j], return_counts=True)
        for end, others in ((0, values[1:]), (-1, values[:-1])):
            if len(others) < 2 or counts[end] < 2:
                continue
            if np.abs(others - values[end]).min() > max(2 * float(np.ptp(others)), 4 * np.pi):
                q[q[:, j] == values[end], j] = np.nan
                told.append(f"q.{joint} is {values[end]:.10g} in {counts[end]} of {len(q)} rows, which is no reading")
    return (replace(log, q=q) if told else log), told


FACTORS = {
    "degrees": 180.0 / np.pi,
    "ticks of 4096 a turn": 4096 / (2 * np.pi),
    "milliradians": 1000.0,
    "ticks of 16384 a turn": 16384 / (2 * np.pi),
    "centidegrees": 18_000.0 / np.pi,
    "ticks of 65536 a turn": 65536 / (2 * np.pi),
}
"""Units that angles come in, by their number in a radian."""
ANGLES = [unit for unit in FACTORS if "ticks" not in unit]
"""Units of measured angles."""
WHOLE = [unit for unit in FACTORS if unit != "degrees"]
"""Units of whole numbers: an encoder counts no degrees."""

JUMP = 0.05
"""A jump is larger than this [rad or m]: see `jump_fault`."""
FASTEST = 10.0
"""… and faster than this [rad/s or m/s]."""


def unit_fault(log: JointLog, limits: FloatArray | None = None) -> str | None:
    """Return what says that positions are in no radians, None where nothing does.

    Args:
        log: The log, as its notes have it; where they say "rad", they are believed.
        limits: Lower and upper limit of each joint (J, 2) [rad], infinite where there is none.
    """
    if log.metadata.get(UNITS) is not None:
        return None
    for name in ("q", "q_des"):
        values = getattr(log, name)
        if values is None:
            continue
        for j, joint in enumerate(log.joints):
            x = values[np.isfinite(values[:, j]), j]
            bound = np.inf if limits is None else float(np.abs(limits[j]).max())
            fault = _unit_fault(x, bound) if len(x) else None
            if fault is not None:
                return f"{name}.{joint} {fault}"
    return None


def _unit_fault(x: FloatArray, bound: float) -> str | None:
    """Return what says that positions of a joint (n,) are in no radians, after its name; None where nothing does.

    Args:
        x: The positions.
        bound: The larger of its limits [rad]; infinite where it has none.
    """
    whole = _whole(x)
    steps = None if whole else _steps_of_a_turn(x)
    if steps is not None:
        return (
            f"has steps of 1/{steps}: turns of an encoder, not radians, by a factor of 6.28; "
            'multiply it by 2 pi, or note "units": "rad" if that is right'
        )
    limited = bool(np.isfinite(bound))
    reach = float(np.abs(x).max())
    plausible = 3 * bound + 1 if limited else 4 * np.pi
    if np.ptp(x) < 2 * np.pi or not (whole or reach > plausible):
        return None
    most = bound if limited else 2 * np.pi
    units = [unit for unit in (WHOLE if whole else ANGLES) if reach <= 1.1 * FACTORS[unit] * most][:3]
    offers = [f"{unit} ({FACTORS[unit]:.4g} a radian)" for unit in units]
    if reach <= 100.0:
        offers.append("percent of the joint's range")
    scales = " or ".join(offers) or "something else"
    limit = f"the joint's limit is {bound:.2f} rad" if limited else "a turn is 6.28 rad"
    sign = ", with a sign bit or from a counter that wraps" if np.abs(np.diff(x)).max() > reach / 2 else ""
    given = f"whole numbers up to {reach:.0f}{sign}" if whole else f"up to {reach:.4g}"
    return (
        f"is {given}, and {limit}: not radians, by a factor of at least {reach / most:.3g}, but "
        f'{scales}; convert it, or note "units": "deg" or "rad" if that is right'
    )


def _steps_of_a_turn(x: FloatArray) -> int | None:
    """Return into how many steps an encoder divides one, where many readings are such shares of one.

    Steps of 360 degrees / 65536 are multiples of 1/8192, too, but all of 45.
    """
    for steps in (2**bits for bits in range(10, 17)):
        counts = np.round(steps * x)
        if np.abs(steps * x - counts).max(initial=0.0) < 0.05 and len(np.unique(counts)) > 50:
            return steps if np.gcd.reduce(np.diff(np.unique(counts)).astype(int)) == 1 else None
    return None


def _whole(x: FloatArray) -> bool:
    """Return whether readings are whole numbers from the first one on, as those of an encoder."""
    return bool(len(x) and (x - x[0] == np.round(x - x[0])).all())


def jump_fault(log: JointLog) -> str | None:
    """Return row and size of the first step of a reading that no joint makes, None where there is none.

    Such a step is five times the steps around it and three times nearly all others. A single reading that is off and
    comes back is none: two steps of one size follow each other.
    """
    for j, joint in enumerate(log.joints):
        rows = np.flatnonzero(np.isfinite(log.q[:, j]) & np.isfinite(log.t))
        if len(rows) < 10 or (_whole(log.q[rows, j]) and np.ptp(log.q[rows, j]) > 2 * np.pi):  # ticks
            continue
        for over in (1, 2):  # a reading between may be the mean of both
            step = log.q[rows[over:], j] - log.q[rows[:-over], j]
            speed = np.abs(step) / np.maximum(log.t[rows[over:]] - log.t[rows[:-over]], 1e-6)
            none = np.zeros(over)
            around = np.maximum(np.append(speed[over:], none), np.append(none, speed[:-over]))
            most = np.maximum(FASTEST, np.maximum(5 * around, 3 * float(np.quantile(speed, 0.99))))
            found = np.flatnonzero((np.abs(step) > JUMP) & (speed > most))
            if not len(found):
                continue
            size = float(step[found[0]])
            row = int(rows[found[0] + over])
            turns = round(size / (2 * np.pi))
            wraps = turns != 0 and abs(size - 2 * np.pi * turns) < 0.5
            why = (
                f"{abs(turns)} turn{'s' * (abs(turns) > 1)}: the encoder wraps around; unwrap it"
                if wraps
                else ("which no joint makes: an encoder that lost counts, or two recordings; cut the log there")
            )
            return f"q.{joint} jumps by {size:+.3f} in row {row + 1} (t = {log.t[row]:.3f} s), {why}"
    return None


def write_log(log: JointLog, path: str | Path) -> Path:
    """Write a log completely or not at all.

    Args:
        log: The log.
        path: ``*.csv`` for CSV with a JSON file of the metadata beside it; anything else is Parquet.

    Returns:
        The path.
    """
    path = Path(path)
    columns: dict[str, FloatArray] = {"t": log.t}
    for channel, values in log.channels.items():
        columns |= {f"{channel}.{joint}": values[:, i] for i, joint in enumerate(log.joints)}
    columns |= log.extra
    if path.suffix.lower() == ".csv":
        with written_whole(path) as part:
            digits = ["%.16g" if name == "t" else "%.9g" for name in columns]
            rows = np.stack(list(columns.values()), -1)
            np.savetxt(part, rows, delimiter=",", header=",".join(columns), comments="", fmt=digits)
        with written_whole(path.with_suffix(".json")) as part:
            part.write_text(json.dumps(plain(log.metadata), indent=1), encoding="utf-8")
        return path
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: np.ascontiguousarray(value) for name, value in columns.items()})
    table = table.replace_schema_metadata({_KEY: json.dumps(plain(log.metadata)).encode()})
    with written_whole(path) as part:
        pq.write_table(table, part)
    return path


def _notes(text: str | bytes, where: str) -> dict[str, Any]:
    """Return the metadata of a log; gains, units and gravity must be what they can be.

    Raises:
        CalibrationError: If it is something else.
    """
    try:
        found = from_json(text)
    except ValueError as reason:
        raise CalibrationError(f"{where} is not JSON: {reason}") from None
    if not isinstance(found, dict):
        raise CalibrationError(f"{where} holds a {type(found).__name__}; expected a JSON object with kp and kd")
    for name in ("kp", "kd"):
        gains = found.get(name, 0.0)
        for gain in gains.values() if isinstance(gains, dict) else [gains]:
            if isinstance(gain, bool) or not isinstance(gain, int | float) or not 0 <= gain < float("inf"):
                raise CalibrationError(
                    f"{where}: {name} is {gains!r}; give a number of at least 0, or one for each joint by name"
                )
    if (units := found.get(UNITS, "rad")) not in ("rad", "deg"):
        raise CalibrationError(f'{where}: {UNITS} is {units!r}; expected "rad" or "deg", of all angles of the log')
    gravity = found.get("gravity", [0.0, 0.0, 0.0])
    numbers = isinstance(gravity, list) and all(isinstance(g, int | float) and abs(g) < 100.0 for g in gravity)
    if not numbers or len(gravity) != 3:
        raise CalibrationError(f"{where}: gravity is {gravity!r}; expected [x, y, z] in the axes of the base, in m/s^2")
    return found


def _check_gains(notes: Mapping[str, Any], joints: Sequence[str], path: Path) -> None:
    """Refuse gains by joint that are not those of the joints.

    Raises:
        CalibrationError: If one is missing, or belongs to no joint.
    """
    for key in ("kp", "kd"):
        gains = notes.get(key)
        if not isinstance(gains, dict):
            continue
        for which, names in (("no", set(joints) - set(gains)), ("a", set(gains) - set(joints))):
            if names:
                raise CalibrationError(
                    f"the metadata of {path} has {which} {key} for {min(names)};"
                    " give one number for all, or one for each of"
                    f" {_some(joints)}"
                )


def _some(columns: Iterable[str]) -> str:
    names = list(columns)
    return ", ".join(names[:8]) + (" …" if len(names) > 8 else "")


OURS = ("t", *CHANNELS, "enabled", "unread", "t_send", "t_receive", "temperature", "voltage", "current")
"""Columns with such a name, or with one before a point, are read as numbers or refused; others may be anything."""

_NONE = ["", "nan", "NaN", "NAN", "na", "NA", "n/a", "N/A", "null", "NULL", "none", "None"]
"""What stands for a missing number in a table of text."""


def _read_csv(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    import pyarrow as pa
    from pyarrow import csv

    text = read_text(path)
    mark = max(",;\t|", key=text.partition("\n")[0].count)
    if mark != ",":
        raise CalibrationError(f"{path} has {mark!r} between its columns; commas are expected, and points in numbers")
    data = text.encode()
    whole = csv.ReadOptions(use_threads=False, block_size=len(data) + 1)  # all rows tell a type
    try:
        table = csv.read_csv(BytesIO(data), whole, convert_options=csv.ConvertOptions(null_values=_NONE))
    except pa.ArrowException as reason:
        raise CalibrationError(f"{path} cannot be read as CSV with a header line: {reason}") from None
    names = [name.strip() for name in table.column_names]
    if len(set(names)) < len(names):
        raise CalibrationError(f"{path} has two columns of one name: {_some(names)}")
    return _numbers(table.rename_columns(names), {}, path), {}


def _read_parquet(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as reason:
        raise CalibrationError(f"{path} cannot be read as Parquet (nor is it named .csv): {reason}") from None
    raw = (table.schema.metadata or {}).get(_KEY)
    notes = _notes(raw, f"the metadata {_KEY.decode()!r} of {path}") if raw else {}
    return _numbers(table, notes, path), notes


def _numbers(table: Any, notes: Mapping[str, Any], path: Path) -> dict[str, FloatArray]:
    """Return the columns that are numbers, times, or True and False.

    Raises:
        CalibrationError: If one with a name of ours is something else, or there is no row.
    """
    import pyarrow as pa

    if not table.num_rows:
        raise CalibrationError(f"{path} has a header, but no rows; a log is a row for each reading")
    columns: dict[str, FloatArray] = {}
    types = pa.types
    for name in table.column_names:
        column = table.column(name)
        if types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        kind = column.type
        try:
            if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
                rows = np.array(column.to_pylist(), dtype=np.float64)  # fails where rows differ in length
                joints = notes.get("joints") or [str(i) for i in range(rows.shape[1])]
                whole = {f"{name}.{joint}": values for joint, values in zip(joints, rows.T, strict=True)}
                columns |= {name: rows[:, 0]} if rows.shape[1] == 1 else whole
                continue
            if types.is_temporal(kind):
                ticks = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[getattr(kind, "unit", "")]
                whole_ticks = column.cast(pa.int32() if types.is_time32(kind) else pa.int64())
                columns[name] = whole_ticks.cast(pa.float64(), safe=False).to_numpy() / ticks
            else:
                plain_kind = column.cast(pa.int8()) if types.is_boolean(kind) else column
                columns[name] = plain_kind.cast(pa.float64(), safe=False).to_numpy()
        except (pa.ArrowException, ValueError, TypeError, KeyError, IndexError):
            if name.split(".")[0] in OURS:
                raise CalibrationError(
                    f"{path}: column {name} is of type {kind}; expected numbers: convert it, or rename the column"
                ) from None
    return columns

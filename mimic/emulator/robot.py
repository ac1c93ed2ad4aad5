"""The emulated robot: motors, IMU and body on one or more buses, in its own time.

Its owner advances the time: a server lets it follow the clock on the wall (`mimic.emulator.server`), a
link in the same process lets it run as fast as it can be computed, and repeatably.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mimic.config.emulator import EmulateSettings
from mimic.dynamics.effect_set import EffectSet
from mimic.emulator.body import EmulatedBody
from mimic.emulator.bus import EmulatedBus, Sent
from mimic.emulator.faults import EmulatedFault, Schedule, miswiring
from mimic.emulator.imu import EmulatedMti
from mimic.emulator.motor import FREE, ROTOR_TURN, Drive, EmulatedMotor, Measured, encode_answer
from mimic.errors import BusError, ConfigError
from mimic.hardware.can.frame import EXTENDED_IDS, STANDARD_IDS, CanFrame, Received
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.motors.cybergear.codec import Codec, Fault, MotorMessage
from mimic.hardware.motors.interface import MotorMode
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription

VOLTAGE = 24.0
"""Of the supply [V]; manual, rated."""

CHECK_PERIOD = 0.01
"""How often motors check temperature, voltage and the time since the last frame of a host [s]."""

SUSPENDED_TIMESTEP = 0.0005
"""Longest physics step of a suspended robot [s]: it is there to be measured, and motors read between the steps."""

POWER_UP = 0.05
"""Motors announce their ids within this time after power-up [s]."""

IMU = "imu"

BROKEN = ("motor_weak", "motor_runaway", "joint_jammed", "encoder_frozen")
"""Faults of drives, joints and encoders."""


@dataclass(eq=False)
class Host:
    """A computer on the emulated buses."""

    node: str
    """Name on the buses."""
    bus: int | None = None
    """The only bus it is on; None for all."""
    heard: deque[Received] = field(default_factory=deque)
    """Received frames that it has not read yet; its own are not among them."""


class EmulatedRobot:
    """Twelve motors and an IMU on their buses, and the body they move."""

    def __init__(
        self,
        description: RobotDescription,
        wiring: Wiring,
        settings: EmulateSettings | None = None,
        *,
        effects: EffectSet | None = None,
        faults: Sequence[EmulatedFault] = (),
        timestep: float = 0.0025,
    ) -> None:
        """Switch the robot on.

        Args:
            description: The robot.
            wiring: Where its motors are.
            settings: How it behaves; by default it lies on the floor, its zeros lost.
            effects: Hidden effects of its drives, links and encoders.
            faults: Scheduled faults; more by `inject`.
            timestep: Of the physics [s]; no more than SUSPENDED_TIMESTEP for a robot that hangs.

        Raises:
            ConfigError: If the effects are not of this robot, or the bus of a fault does not exist.
        """
        if wiring.maker != "cybergear":
            raise ConfigError(f"the emulated robot has CyberGear motors; {wiring.path} names {wiring.maker!r}")
        self.settings = s = EmulateSettings() if settings is None else settings
        self.wiring = wiring
        self.body = EmulatedBody(
            description,
            effects=effects,
            suspended=s.suspended,
            folded=not s.zeroed,
            timestep=min(timestep, SUSPENDED_TIMESTEP) if s.suspended else timestep,
            placement=s.placement,
            seed=s.seed,
        )
        self.buses = [EmulatedBus(wiring.bitrate) for _ in range(wiring.buses)]
        self.imu = EmulatedMti(wiring.imu, noise=s.imu_noise, seed=s.seed)
        self.body.miswire(*miswiring(faults), wiring.offset)
        self.now = 0.0
        """Time of the emulation [s]."""
        self._on = False
        self._without_zero = set[int]() if s.zeroed else set(range(len(JOINTS)))
        self._rng = np.random.default_rng([s.seed, 29])
        self.schedule = Schedule((), self._rng)
        self._happened: set[int] = set()
        self._codec = Codec(position_range=s.position_range, host=wiring.host)
        self.motors = [
            EmulatedMotor(
                id=int(wiring.motor[i]),
                uid=int(self._rng.integers(1 << 62)),
                codec=self._codec,
                encoder=float(self._rng.uniform(0.0, ROTOR_TURN)),
                timeout_honoured=s.can_timeout,
                host=wiring.host,
            )
            for i in range(len(JOINTS))
        ]
        """In the order of the joints."""
        self._on_bus: list[list[int]] = [[] for _ in range(wiring.buses)]
        for joint, bus in enumerate(wiring.bus):
            self._on_bus[bus].append(joint)
        self._driven: list[Drive | None] = [FREE] * len(JOINTS)
        self._stuck: dict[int, float] = {}
        """Joints whose encoder is frozen -> the angle that it reads [rad]."""
        self.events: deque[tuple[float, str]] = deque(maxlen=1000)
        """Log of events with their times [s]: faults, the first motor switched on."""
        self._late: list[tuple[float, int, int, Sent]] = []
        self._late_count = 0
        self._next_check = CHECK_PERIOD
        self._hosts: list[Host] = []
        self._host_count = 0
        self.oldest = 0.0
        """Age of the oldest command by which a motor was driven [s]."""
        for i, motor in enumerate(self.motors):
            announcement = motor.power_up(self._measured(i).q)
            if s.zeroed:
                motor.zero = 0.0
            self._answer(i, announcement, self._rng.uniform(0.0, POWER_UP))
        for fault in faults:
            self.inject(fault)

    # ------------------------------------------------------------------ hosts and faults

    def inject(self, fault: EmulatedFault) -> None:
        """Schedule a fault; one whose start has passed begins now.

        Raises:
            ConfigError: If its bus does not exist.
        """
        if fault.bus is not None and fault.bus >= len(self.buses):
            raise ConfigError(f"the fault {fault} is on bus {fault.bus}; this robot has {len(self.buses)}")
        self.schedule.faults.append(fault.released(self.now) if self._on else fault)

    def connect(self, *, bus: int | None = None) -> Host:
        """Return a new host, on one bus or on all."""
        self._host_count += 1
        host = Host(f"host{self._host_count}", bus)
        self._hosts.append(host)
        return host

    def disconnect(self, host: Host) -> None:
        """Remove a host from the buses; frames it has sent still go out."""
        if host in self._hosts:
            self._hosts.remove(host)

    def send(self, host: Host, bus: int, frame: CanFrame, *, at: float | None = None) -> None:
        """Let a host send a frame on a bus, now or from a later time on.

        Raises:
            BusError: If the bus is unplugged.
        """
        if self.unplugged(bus):
            raise BusError(f"bus {bus} is unplugged")
        at = self.now if at is None else max(at, self.now)
        self.buses[bus].submit(host.node, frame, max(at, self._held_until(bus)))

    def unplugged(self, bus: int) -> bool:
        """Return whether the adapter of a bus is unplugged."""
        return self._value("unplugged", bus=bus) is not None

    @property
    def next_event(self) -> float:
        """Time of the next event if no host sends anything [s]."""
        soonest = min(self.imu.next_sample, self._next_check, *(bus.next_event for bus in self.buses))
        if self._late:
            soonest = min(soonest, self._late[0][0])
        for i, fault in enumerate(self.schedule.faults):
            if i not in self._happened and not fault.after_release:
                soonest = min(soonest, fault.start)
        return soonest

    def advance(self, until: float, *, waiting: Host | None = None) -> None:
        """Advance time to ``until`` [s], or only until a waiting host receives a frame."""
        while (event := self.next_event) <= until:
            self.now = max(self.now, event)
            self._happen()
            if waiting is not None and waiting.heard:
                return
        self.now = max(self.now, until)
        self.body.advance(self.now)

    def switched_on(self) -> tuple[str, ...]:
        """Return the joints whose motors are on."""
        return tuple(name for name, motor in zip(JOINTS, self.motors, strict=True) if motor.mode is MotorMode.RUNNING)

    def driven(self) -> tuple[str, ...]:
        """Return the joints whose motors are on with stiffness or torque, rather than damped."""
        on = self.switched_on()
        return tuple(n for n, motor in zip(JOINTS, self.motors, strict=True) if n in on and motor.drive.drives)

    def load(self, bus: int = 0) -> float:
        """Return the share of time that a bus was busy since power-up."""
        return self.buses[bus].bits / self.buses[bus].bitrate / self.now if self.now else 0.0

    # ------------------------------------------------------------------ events

    def _happen(self) -> None:
        """Process all events that are due now."""
        for i, fault in enumerate(self.schedule.faults):
            if i not in self._happened and fault.start <= self.now and not fault.after_release:
                self._happened.add(i)
                self.events.append((self.now, str(fault)))
                self._begin(fault)
        for index, bus in enumerate(self.buses):
            bus.off = self._value("bus_off", bus=index) is not None or self.unplugged(index)
            if bus.off or bus.next_event <= self.now:
                sent = bus.advance()
                if sent is not None:
                    self._pass_on(index, sent)
        while self._late and self._late[0][0] <= self.now:
            _, _, index, sent = heapq.heappop(self._late)
            self._deliver(index, sent._replace(t=self.now))
        if self.imu.next_sample <= self.now:
            self._sample_imu()
        if self._next_check <= self.now:
            self._next_check += CHECK_PERIOD
            self._check_motors()

    def _begin(self, fault: EmulatedFault) -> None:
        """Apply the immediate effect of a fault that begins."""
        if fault.kind == "power_cycle" and fault.joint is not None:
            i = fault.joint
            announcement = self.motors[i].power_up(self._measured(i).q)
            self._apply(i)
            self._answer(i, announcement, self.now + self._rng.uniform(0.0, POWER_UP))
        elif fault.kind == "motor_dead" and fault.joint is not None:
            self.motors[fault.joint].power_up(self._measured(fault.joint).q)
            self._apply(fault.joint)

    def _pass_on(self, index: int, sent: Sent) -> None:
        """Deliver a frame to its receivers: once, twice, late, corrupted or never."""
        if not self.schedule.faults:
            return self._deliver(index, sent)
        happens = self.schedule.happens
        if happens("frames_lost", self.now, index):
            return
        if happens("frames_corrupted", self.now, index):
            sent = sent._replace(frame=self._corrupted(sent.frame))
        count = 2 if happens("frames_doubled", self.now, index) else 1
        held = self._held_until(index) if not sent.node.startswith("host") else 0.0
        due = max(sent.t + (self._value("frames_late", bus=index) or 0.0), held)
        for _ in range(count):
            if due > sent.t:
                self._late_count += 1
                heapq.heappush(self._late, (due, self._late_count, index, sent))
            else:
                self._deliver(index, sent)

    def _corrupted(self, frame: CanFrame) -> CanFrame:
        bits = (29 if frame.extended else 11) + 8 * len(frame.data)
        place = int(self._rng.integers(bits))
        if place < 8 * len(frame.data):
            data = bytearray(frame.data)
            data[place // 8] ^= 1 << place % 8
            return CanFrame(frame.id, bytes(data), frame.extended)
        identifier = frame.id ^ 1 << (place - 8 * len(frame.data))
        return CanFrame(identifier % (EXTENDED_IDS if frame.extended else STANDARD_IDS), frame.data, frame.extended)

    def _deliver(self, index: int, sent: Sent) -> None:
        if sent.node.startswith("host"):
            motor = sent.frame.id & 0xFF if sent.frame.extended else None
            for i in (i for i in self._on_bus[index] if self.motors[i].id == motor):
                if self._value("motor_dead", joint=i) is None and self._value("motor_deaf", joint=i) is None:
                    self._hear(i, sent)
        for host in self._hosts:
            if host.node != sent.node and host.bus in (None, index):
                host.heard.append(Received(index, sent.frame, sent.t))

    def _hear(self, i: int, sent: Sent) -> None:
        motor = self.motors[i]
        zero = self.motors[i].zero
        self._count_age(motor, sent.t)
        answer = motor.hear(sent.frame, sent.t, self._measured(i))
        self._apply(i)
        if motor.zero != zero:
            self._zero_set(i)
        if motor.mode is MotorMode.RUNNING and not self._on:
            self._on = True
            self.body.release()
            self.events.append((self.now, "first motor switched on; the robot is no longer held"))
            self.schedule.release(self.now)
        if answer is not None:
            self._answer(i, answer, sent.t + self.settings.reply)

    def _count_age(self, motor: EmulatedMotor, t: float) -> None:
        if motor.mode is MotorMode.RUNNING and motor.drive.kp > 0.0:
            self.oldest = max(self.oldest, t - motor.heard_at)

    def _zero_set(self, i: int) -> None:
        """Let go of a robot whose legs were kept folded for its zeros, once it has the last of them."""
        if i in self._without_zero:
            self._without_zero.remove(i)
            if not self._without_zero and self.body.held:
                self.body.release()
                self.events.append((self.now, "the zeros are set; the robot is no longer held, and sinks"))

    def _answer(self, i: int, message: MotorMessage, ready: float) -> None:
        if self._value("motor_mute", joint=i) is None and self._value("motor_dead", joint=i) is None:
            self.buses[int(self.wiring.bus[i])].submit(f"motor{i}", encode_answer(self._codec, message), ready)

    def _apply(self, i: int) -> None:
        """Pass a motor's drive to the body, in the joint's sign and zero."""
        drive = self.motors[i].drive
        if drive is self._driven[i]:
            return
        self._driven[i] = drive
        sign = float(self.wiring.sign[i])
        offset = float(self.wiring.offset[i])
        drive = self._broken(i, drive, sign, offset)
        drive = drive._replace(q=sign * drive.q + offset, dq=sign * drive.dq, tau=sign * drive.tau)
        self.body.drive(i, drive, self.now)

    def _broken(self, i: int, drive: Drive, sign: float, offset: float) -> Drive:
        """Return what a motor does instead of what it is told, in its own sign and zero."""
        runaway = self._value("motor_runaway", joint=i)
        weak = self._value("motor_weak", joint=i)
        if runaway is not None and self.motors[i].mode is MotorMode.RUNNING:
            return Drive(tau=runaway, limit=abs(runaway))
        if i in self._stuck:
            tau = drive.tau + drive.kp * (drive.q - sign * (self._stuck[i] - offset)) + drive.kd * drive.dq
            drive = Drive(tau=float(np.clip(tau, -drive.limit, drive.limit)), limit=drive.limit)
        return drive if weak is None else drive._replace(limit=weak * drive.limit)

    def _break(self, i: int) -> None:
        """Let faults of a drive begin and end."""
        if self._value("encoder_frozen", joint=i) is None:
            self._stuck.pop(i, None)
        elif i not in self._stuck:
            self._stuck[i] = self.body.joint(i, self.now)[0]
        self.body.jam(i, self._value("joint_jammed", joint=i) or 0.0)
        self._driven[i] = None  # so that it is driven anew

    def _measured(self, i: int) -> Measured:
        self.body.advance(self.now)
        q, dq, tau = self.body.joint(i, self.now)
        if i in self._stuck:
            q = self._stuck[i]
            dq = 0.0
        sign = float(self.wiring.sign[i])
        offset = float(self.wiring.offset[i])
        return Measured(sign * (q - offset), sign * dq, sign * tau, *self._heat_and_voltage(i))

    def _heat_and_voltage(self, i: int) -> tuple[float, float]:
        heat = self.body.temperature(i)
        hot = self._value("motor_hot", joint=i)
        voltage = self._value("under_voltage")
        return heat if hot is None else max(heat, hot), VOLTAGE if voltage is None else voltage

    def _check_motors(self) -> None:
        self.body.advance(self.now)
        for i, motor in enumerate(self.motors):
            if self._value("motor_dead", joint=i) is not None:
                continue
            self._count_age(motor, self.now)
            bits = self._value("motor_fault", joint=i)
            more = Fault(0) if bits is None else Fault(int(bits) & 0x3F)
            report = motor.check_faults(self.now, *self._heat_and_voltage(i), more)
            if any(fault.joint == i and fault.kind in BROKEN for fault in self.schedule.faults):
                self._break(i)
            self._apply(i)
            if report is not None:
                self._answer(i, report, self.now)

    def _sample_imu(self) -> None:
        self.body.advance(self.now)
        frames = self.imu.sample(
            *self.body.base(),
            valid=self._value("imu_invalid") is None,
            frozen=self._value("imu_frozen") is not None,
            stuck=self._value("imu_stuck") is not None,
            tilt=self._tilt(),
        )
        if self._value("imu_silent") is None:
            for frame in frames:
                self.buses[self.wiring.imu.bus].submit(IMU, frame, self.now)

    def _tilt(self) -> float:
        """Return by what the next orientation is wrong [rad]."""
        if self.schedule.happens("imu_forged", self.now):
            return float(self._rng.uniform(0.5, 3.0))
        return self._value("imu_tilted") or 0.0

    def _value(self, kind: str, *, joint: int | None = None, bus: int | None = None) -> float | None:
        """Return the value of an active fault, or None."""
        return self.schedule.value(kind, self.now, joint=joint, bus=bus)

    def _held_until(self, bus: int) -> float:
        """Return until when the adapter of a bus holds frames back [s]; 0 if it does not."""
        ends = [
            f.until for f in self.schedule.faults if f.kind == "stalled" and f.bus in (None, bus) and f.active(self.now)
        ]
        return max(ends, default=0.0)

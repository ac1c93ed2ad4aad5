"""What a drive does in one physics step: the laws of the catalogue, the same code in NumPy and in PyTorch.

A step of the physics is given the torque of each joint, the inertia of its drive, dry friction and a torque from
outside. `Law` computes these from position, velocity and target. A torque that falls by ``kd`` with the velocity is
implicit in it as an inertia of ``kd dt``, of which dry friction and contacts know as well. Damping acts on the mean of
the velocities at both ends of a step (Crank and Nicolson), lags on its mean over the step, so that steps of 2.5 ms come
within 0.2 mrad of steps of 0.25 ms; the rotor behind a gear and its contact with the link are implicit in both of their
velocities. All is stable at any step.

Arrays are (N, J): N simulations, J joints; parameters of the whole machine are (N, 1).

Longer than 350 lines: the laws of one step share its torques, and read best in the order in which they act.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mimic.dynamics.catalogue import effect

Parameters = Mapping[tuple[str, str], Any]
"""(effect, parameter) -> values (N, J), or (N, 1) for the whole machine. What is not there is neutral."""

LEAST_SUPPLY = 0.1
"""Share of the supply that is left whatever is drawn."""

NEWTON = 10
"""Most steps towards the share of the supply that is left."""
EXACT = 1e-9
"""Error at which they end; in single precision a few roundings, below which steps would leave the root again."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drives:
    """Numbers of the drives that the laws start from; arrays (J,)."""

    kp: Any
    """[N m/rad]"""
    kd: Any
    """[N m s/rad]"""
    torque: Any
    """Peak torque [N m]."""
    flat: Any
    """Speed up to which it is there [rad/s]."""
    speed: Any
    """Speed at which none is left [rad/s]."""
    friction: Any
    """Dry friction [N m]."""
    armature: Any
    """[kg m^2]"""
    neighbour: Any
    """Index of the next joint of the chain; of the one before, for the last (J,)."""
    volts: Any = None
    """Supply of voltage drives (J,) [V]; None where drives control torque.

    A voltage drive gives tau = kt / R (V duty - kt v), duty = gain e within -1 to 1: Kp is gain kt V / R and Kd is
    kt^2 / R, and the duty is limited, not the torque.
    """
    kt: Any = None
    """Torque constant of voltage drives, gear included (J,) [N m/A]."""
    resistance: Any = None
    """Resistance of their windings (J,) [ohm]."""


OF_DRIVES = {
    ("coulomb", "level"): "friction",
    ("armature", "inertia"): "armature",
    **{("torque_speed", name): name for name in ("torque", "flat", "speed")},
    **{("motor", name): name for name in ("kt", "resistance")},
}
"""Which numbers of the drives are the neutral values of effects."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StepInputs:
    """What the physics gets for one step (N, J)."""

    torque: Any
    """Of the drive on the link at the start of the step [N m]."""
    inertia: Any
    """Of the drive as the link feels it, with what makes the torque implicit [kg m^2]."""
    friction: Any
    """Dry friction of the joint [N m]."""
    applied: Any
    """Torque on the joint from outside the drive [N m]."""
    tau: Any
    """Torque of the motor at the start of the step, limits included [N m]."""


class Law:
    """The laws of one batch of simulations, with the states they need from step to step."""

    def __init__(
        self, drives: Drives, parameters: Parameters, timestep: float, shape: tuple[int, int], xp: Any
    ) -> None:
        """Take numbers and make the states.

        Args:
            drives: Numbers of the drives, as arrays of ``xp``.
            parameters: Values of the effects that any of the simulations has.
            timestep: Physics step [s].
            shape: (N, J).
            xp: ``numpy``, or an object with its functions on tensors such as ``torch``.
        """
        self.dt = timestep
        self.xp = xp
        self._d = drives
        self._p = dict(parameters)
        self._has = {name for name, _ in self._p}
        self._zero = xp.broadcast_to(drives.kp * 0.0, shape) + 0.0
        self.needed: Any = 0.0
        """Torque that the links need against gravity and for their motion (N, J) [N m], see `Servo`: the owner of the
        physics gives it once, and it follows the physics."""
        self.states: dict[str, Any] = {}
        self._fixed()

    # ------------------------------------------------------------------ set-up

    def get(self, name: str, parameter: str) -> Any:
        """Return a parameter, or its neutral value where no simulation has the effect."""
        if (name, parameter) in self._p:
            return self._p[name, parameter]
        neutral = effect(name).parameter(parameter).neutral
        return getattr(self._d, OF_DRIVES[name, parameter])[None] if neutral == "model" else neutral

    def _fixed(self) -> None:
        """Compute what does not change from step to step."""
        xp = self.xp
        has = self._has
        self._kp = xp.zeros_like(self._zero)
        self._kd = xp.zeros_like(self._zero)
        self.set_gains(self._d.kp, self._d.kd)
        self._level = self._zero + self.get("coulomb", "level")
        self._limits = tuple(self._zero + self.get("torque_speed", name) for name in ("torque", "flat", "speed"))
        self._slope = self._limits[0] / (self._limits[2] - self._limits[1])
        self._most: Any = None
        self._exact = max(EXACT, 4.0 * float(xp.finfo(self._zero.dtype).eps))
        self.rotor: Any = self._rotor_constants() if has & {"backlash", "compliance"} else None
        self._inertia = self._zero + self.get("armature", "inertia")
        if self.rotor is not None:
            self._inertia = xp.where(self.rotor["there"], self._zero, self._inertia)
        state = ["velocity", "velocity_before"] if "velocity_lag" in has else []
        if "torque_lag" in has:
            state += ["torque", "torque_open", "torque_kd", "velocity_before"]
        if "kt_heat" in has:
            state += ["heat"]
        if self.rotor is not None:
            state += ["theta", "omega", "omega_open", "omega_slope"]
        if "target_filter" in has:
            state += ["goal"]
        for name in state:
            self.states[name] = xp.zeros_like(self._zero)
        self._lag_u = self._lag("target_filter")
        self._lag_v = self._lag("velocity_lag")
        self._lag_t = self._lag("torque_lag")

    def _lag(self, name: str) -> tuple[Any, Any] | None:
        """Return what is left of a first-order lag's state after a step, and its mean share during the step."""
        if name not in self._has:
            return None
        time = self.xp.clip(self._zero + self.get(name, "time"), 1e-7, None)
        left = self.xp.exp(-self.dt / time)
        return left, time / self.dt * (1 - left)

    def _rotor_constants(self) -> dict[str, Any]:
        xp = self.xp
        compliance = self._zero + self.get("compliance", "compliance")
        touching = self._zero + self.get("backlash", "compliance")
        half = (self._zero + self.get("backlash", "gap")) / 2
        there = (compliance > 0) | (half > 0)
        stiffness = 1.0 / xp.where(compliance > 0, compliance, touching)
        inertia = xp.clip(self._zero + self.get("armature", "inertia"), 1e-5, None)
        return {
            "there": there,
            "half": half,
            "stiffness": stiffness,
            "coupling": stiffness * self.dt + 2 * self.get("compliance", "damping") * xp.sqrt(stiffness * inertia),
            "inertia": inertia,
        }

    # ------------------------------------------------------------------ a run

    def set_gains(self, kp: Any, kd: Any) -> None:
        """Give the drives other gains from now on, (J,) or (N, J), on which the effects act as on the first ones."""
        kp = self._zero + kp
        kd = self._zero + kd
        for name, of_kp, of_kd in (
            ("gains", "kp", "kd"),
            ("kt_gain", "factor", "factor"),
            ("encoder_scale", "factor", "factor"),
        ):
            if name in self._has:
                kp = kp * self.get(name, of_kp)
                kd = kd * self.get(name, of_kd)
        self._kp[:] = kp
        self._kd[:] = kd

    def limit_torque(self, most: Any) -> None:
        """Let the drives give no more than this from now on (N, J) [N m], whatever they could."""
        self._most = most

    def begin(self, q: Any, dq: Any, where: Any = None) -> None:
        """Begin a run at link positions q, in all simulations or in those of ``where`` (N, 1), the others go on."""
        known = {
            "velocity": dq,
            "velocity_before": dq,
            "theta": q,
            "omega": dq,
            "omega_open": dq,
            "goal": q,
        }
        for name, before in self.states.items():
            value = self._zero + known.get(name, 0.0)
            self.states[name] = value if where is None else self.xp.where(where, value, before)

    def _beside(self, q: Any) -> Any:
        """Return what an eccentric encoder reads too much."""
        xp = self.xp
        get = self.get
        angle = self._zero + q
        cosine = get("encoder_eccentricity", "cosine") * xp.cos(angle)
        return cosine + get("encoder_eccentricity", "sine") * xp.sin(angle)

    def reading(self, q: Any) -> Any:
        """Return what the encoders read at link positions q; call it after `step` or `begin`."""
        value = self._position(q)
        if "encoder_eccentricity" in self._has:
            value = value + self._beside(value)
        if "encoder_scale" in self._has:
            value = value * self.get("encoder_scale", "factor")
        if "encoder_offset" in self._has:
            value = value + self.get("encoder_offset", "angle")
        if "encoder_step" in self._has:
            value = self._rounded(value)
        return value

    def _position(self, q: Any) -> Any:
        return q if self.rotor is None else self.xp.where(self.rotor["there"], self.states["theta"], q)

    def _rounded(self, value: Any) -> Any:
        xp = self.xp
        step = self._zero + self.get("encoder_step", "angle")
        safe = xp.clip(step, 1e-9, None)
        return xp.where(step > 0, safe * xp.round(value / safe), value)

    def settle(self, dq: Any) -> None:
        """Bring the states to the end of the step just made, whose velocities are dq (N, J)."""
        s = self.states
        dt = self.dt
        if self.rotor is not None:
            s["omega"] = s["omega_open"] + s["omega_slope"] * dq
            s["theta"] = s["theta"] + dt * s["omega"]
            dq = self.xp.where(self.rotor["there"], s["omega"], dq)
        if "velocity_before" not in s:
            return
        mean = (s["velocity_before"] + dq) / 2
        if self._lag_t is not None:
            left = self._lag_t[0]
            s["torque"] = left * s["torque"] + (1 - left) * (s["torque_open"] - s["torque_kd"] * mean)
        if self._lag_v is not None:
            left = self._lag_v[0]
            s["velocity"] = left * s["velocity"] + (1 - left) * mean

    def step(self, q: Any, dq: Any, target: Any, time: Any, force: Any = None) -> StepInputs:
        """Return what the physics gets for the next step; `settle` must follow once it is made.

        Args:
            q: Link positions (N, J) [rad].
            dq: Link velocities (N, J) [rad/s].
            target: Target of each drive in effect during the step, its mean (N, J) [rad].
            time: Since the beginning of the log [s], (N, 1) or a number.
            force: Torque put in besides the servo's (N, J) [N m].
        """
        xp = self.xp
        has = self._has
        get = self.get
        s = self.states
        theta = self._position(q)
        omega = dq
        if self.rotor is not None:
            omega = xp.where(self.rotor["there"], s["omega"], dq)
        kp = self._kp
        kd = self._kd
        ctrl = target + self._zero
        bias = self._zero
        if "encoder_offset" in has:
            ctrl = ctrl - get("encoder_offset", "angle")
        if "encoder_scale" in has:
            ctrl = ctrl / get("encoder_scale", "factor")
        if self._lag_u is not None:
            left, held = self._lag_u
            wanted = ctrl
            ctrl = ctrl + held * (s["goal"] - ctrl)
            s["goal"] = wanted + left * (s["goal"] - wanted)
        if has & {"kt_drift", "kt_heat"}:
            factor = 1.0 + get("kt_drift", "rate") * (time / 100.0)
            if "heat" in s:
                factor = factor * (1.0 - get("kt_heat", "loss") * s["heat"])
            factor = xp.clip(factor + self._zero, 0.05, None)
            kp = kp * factor
            kd = kd * factor
        if "encoder_step" in has:
            bias = bias - kp * (self._rounded(theta) - theta)
        if "encoder_eccentricity" in has:
            bias = bias - kp * self._beside(theta)
        if "velocity_before" in s:
            s["velocity_before"] = omega + self._zero
        if self._lag_v is not None:
            held = self._lag_v[1]
            bias = bias - kd * held * s["velocity"]
            kd = kd * (1 - held)
        if force is not None:
            bias = bias + force
        if self._lag_t is not None:
            held = self._lag_t[1]
            s["torque_open"] = kp * (ctrl - theta) + bias
            s["torque_kd"] = kd
            kp = kp * (1 - held)
            kd = kd * (1 - held)
            bias = bias * (1 - held) + held * s["torque"]
        asked = kp * (ctrl - theta) + bias - kd * omega
        low, high = self._torque_limits(omega, self._supply_left(asked, omega))
        tau = xp.minimum(xp.maximum(asked, low), high)
        if "heat" in s:
            s["heat"] = s["heat"] + self.dt * (tau * tau - s["heat"]) / get("kt_heat", "time")
        friction, bent = self._friction(q, dq, tau)
        applied = self._outside(q, dq) - bent
        kd = kd / 2  # Crank and Nicolson: the mean of both ends of the step
        brake = kd * omega
        free = kp * (ctrl - theta) + bias - brake
        asked = free - brake
        torque = xp.minimum(xp.maximum(asked, low), high)
        kept = xp.where(torque == asked, kd, self._zero)
        if self.rotor is not None:
            torque, kept = self._through_gear(q, dq, free, kd, low, high, torque, kept)
        inertia = self._inertia + self.dt * kept
        return StepInputs(torque=torque, inertia=inertia, friction=friction, applied=applied, tau=tau)

    def _torque_limits(self, omega: Any, left: Any) -> tuple[Any, Any]:
        """Return the least and greatest torque at velocities omega (N, J) with these shares of the supply (N, 1)."""
        xp = self.xp
        slope = self._slope
        (torque, _, speed) = self._limits
        if left is not None:
            torque = torque * left
            speed = speed * left
        high = xp.minimum(xp.maximum((speed - omega) * slope, self._zero), torque)
        low = -xp.minimum(xp.maximum((speed + omega) * slope, self._zero), torque)
        if self._most is not None:
            low = xp.maximum(low, -self._most)
            high = xp.minimum(high, self._most)
        return low, high

    def _supply_left(self, asked: Any, omega: Any) -> Any:
        """Return the share of the supply (N, 1) left when motors draw what that share allows; None where it is stiff.

        The more is left, the more they draw: the one root of a falling function of straight pieces, by Newton's steps
        that stay between what is known to be too little and too much.
        """
        if "supply_sag" not in self._has:
            return None
        xp = self.xp
        zero = self._zero
        slope = self._slope
        (torque, _, speed) = self._limits
        fast = xp.abs(omega)
        size = xp.abs(asked)
        if self._most is not None:
            size = xp.minimum(size, self._most)
        size = xp.where(asked * omega > 0, size, zero)
        rise = speed * slope
        begin = fast * slope
        loss = self.get("supply_sag", "drop") * fast
        low = zero[:, :1] + LEAST_SUPPLY
        high = zero[:, :1] + 1.0
        left = high
        for _ in range(NEWTON):
            stall = torque * left
            line = rise * left - begin
            most = xp.minimum(stall, line)
            steep = xp.where((most > 0) & (most < size), xp.where(stall < line, torque, rise), zero)
            beyond = 1.0 - left - (loss * xp.minimum(xp.maximum(most, zero), size)).sum(-1)[..., None]
            exact = xp.abs(beyond) < self._exact
            if xp is np and exact.all():
                break
            low = xp.where(beyond > 0, left, low)
            high = xp.where(beyond > 0, high, left)
            step = left + beyond / (1.0 + (loss * steep).sum(-1)[..., None])
            inside = (step > low) & (step < high)
            left = xp.where(exact, left, xp.where(inside, step, (low + high) / 2))
        return left

    def _friction(self, q: Any, dq: Any, tau: Any) -> tuple[Any, Any]:
        """Return dry friction at these motor torques, and the torque by which one direction has more.

        Friction of F + A forward and F - A backward is friction F with a torque -A, at rest too.
        """
        xp = self.xp
        get = self.get
        level = self._level
        bent = self._zero
        if "stribeck" in self._has:
            level = level + get("stribeck", "level") * xp.exp(-((dq / get("stribeck", "speed")) ** 2))
        if "load_friction" in self._has:
            level = level + get("load_friction", "ratio") * xp.abs(tau)
        if "gear_load_friction" in self._has:
            level = level + get("gear_load_friction", "ratio") * xp.abs(tau + self.needed)
        if "asymmetric_friction" in self._has:
            more = get("asymmetric_friction", "level")
            forward = xp.clip(level + more, 0.0, None)
            backward = xp.clip(level - more, 0.0, None)
            level = (forward + backward) / 2
            bent = (forward - backward) / 2
        return level, bent

    def _outside(self, q: Any, dq: Any) -> Any:
        xp = self.xp
        get = self.get
        has = self._has
        applied = self._zero
        if "asymmetric_friction" in has:
            applied = applied - get("asymmetric_friction", "coefficient") * xp.abs(dq)
        if "quadratic_drag" in has:
            applied = applied - get("quadratic_drag", "coefficient") * dq * xp.abs(dq)
        if "coupling" in has:
            applied = applied - get("coupling", "coefficient") * dq[:, self._d.neighbour]
        if "cogging" in has:
            angle = get("cogging", "order") * q
            applied = applied + get("cogging", "cosine") * xp.cos(angle) + get("cogging", "sine") * xp.sin(angle)
        if "spring" in has:
            applied = applied + get("spring", "moment") - get("spring", "stiffness") * q
        return applied

    def _through_gear(
        self, q: Any, dq: Any, free: Any, kd: Any, low: Any, high: Any, torque: Any, kept: Any
    ) -> tuple[Any, Any]:
        """Return torque and damping of the link when a rotor and its transmission stand between motor and link.

        Rotor: J (w' - w) / dt = tau(w') - c(w', v'), with the torque of the transmission
        c = k x + K (w' - v') where it touches, K = k dt + d, and x the twist beyond the gap; primes mark the end of
        the step. It touches where the rotor would end beyond the gap if it did not. Solved for w' = open + slope v', so
        that c enters the link as a torque and a damping.
        """
        xp = self.xp
        r = self.rotor
        s = self.states
        twist = s["theta"] - q
        alone, _ = self._rotor_speed(free, kd, low, high, dq, self._zero, self._zero)
        over = twist + self.dt * (alone - dq)
        edge = xp.minimum(xp.maximum(over, -r["half"]), r["half"])
        touching = (over != edge) | (r["half"] <= 0)
        spring = xp.where(touching, r["stiffness"] * (twist - edge), self._zero)
        engaged = xp.where(touching, r["coupling"], self._zero)
        opened, slope = self._rotor_speed(free, kd, low, high, dq, spring, engaged)
        there = r["there"]
        damping = engaged * (1 - slope)
        s["omega_open"] = xp.where(there, opened, self._zero)
        s["omega_slope"] = xp.where(there, slope, self._zero + 1.0)
        given = spring + engaged * opened - damping * dq
        return xp.where(there, given, torque), xp.where(there, damping, kept)

    def _rotor_speed(
        self, free: Any, kd: Any, low: Any, high: Any, dq: Any, spring: Any, engaged: Any
    ) -> tuple[Any, Any]:
        """Return what the speed of the rotor at the end of a step is beside a share of the link's, and that share.

        The motor is at a limit where its torque at the end of the step would be beyond, were the link as fast as now.
        """
        xp = self.xp
        dt = self.dt
        inertia = self.rotor["inertia"]
        omega = self.states["omega"]
        mass = inertia + dt * (kd + engaged)
        asked = free - kd * (inertia * omega + dt * (free - spring + engaged * dq)) / mass
        drive = xp.minimum(xp.maximum(asked, low), high)
        limited = drive != asked
        mass = xp.where(limited, inertia + dt * engaged, mass)
        opened = (inertia * omega + dt * (xp.where(limited, drive, free) - spring)) / mass
        return opened, dt * engaged / mass

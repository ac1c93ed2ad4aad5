"""Physics of legs on a fixed base, written for the benchmark alone: nothing here is shared with mimic's replay.

Rigid-body dynamics by Newton and Euler in base axes; time stepping after Moreau and Jean (midpoint rule for what is
smooth, dry friction as a set-valued law solved for the velocity at the end of the step), so that a joint at rest does
not creep. Motor and link are separate bodies where a joint has play or elasticity.

Where two readings of an equation of the catalogue are possible, this is the one taken:
    gap          whole width of the play, so each side has half of it; the flanks are springs of 2e4 N m/rad
    friction     dry and viscous friction act on the link, not on the motor (column ``motor_side`` moves them)
    torque       PD, then torque constant, then lag, then limits
    base tilt    the base is turned: gravity in base axes = (Ry(pitch) Rx(roll))^T (0, 0, -g)
    sag          the share of supply at which what the motors draw leaves just that share, down to 0.2
    encoder step the drive's position term sees the steps, its velocity term does not

Columns that make a law another one than the catalogue's are neutral where `generator.OTHER_LAWS` does not set them.

Source: Featherstone 2008, chapter 5 (recursive Newton-Euler); Acary and Brogliato 2008, chapter 10 (Moreau-Jean).
"""

# ruff: noqa: E741, SIM905
from __future__ import annotations

import math

import numpy as np

try:
    from numba import njit
except ImportError:  # a hundred times slower, same numbers

    def njit(*args, **options):
        return args[0] if args and callable(args[0]) else lambda f: f


FLANK = 2.0e4
"""Stiffness of what touches at the ends of a gap, where the machine does not say otherwise [N m/rad]."""
FLANK_DAMPING = 0.3
"""Damping ratio there."""
STOP_STIFFNESS, STOP_DAMPING = 400.0, 2.0
"""End stops of the joints [N m/rad, N m s/rad]."""
SUBSTEPS = 4
"""Steps taken in one where a leg has a motor of its own."""

# Columns of the joints' parameters.
COLUMNS = (
    "friction damping armature kp kd torque speed flat kt drift heat_loss heat_time torque_lag velocity_lag "
    "stribeck stribeck_speed load asymmetric asymmetric_viscous drag coupling gap compliance "
    "offset scale step cog_cos cog_sin cog_order stiffness moment force_cos force_sin force_hz low high motor_side "
    "stop_k stop_q eccentric eccentric_phase wear wear_travel imbalance imbalance_order imbalance_phase "
    "cable_k cable_torque detent detent_q detent_width "
    "integral deadband target_lag friction_wave load_power stribeck_power drag_power cubic second_cog hardening flank "
    "slip slip_travel zero_drift"
).split()
(
    FC, D, JA, KP, KD, TMAX, VMAX, VFLAT, KT, DRIFT, HLOSS, HTIME, TLAG, VLAG,
    FS, VS, MU, FA, DA, D2, COUP, GAP, COMP,
    OFF, SCALE, STEP, COGC, COGS, COGN, SPR, MOM, PC, PS, PF, LOW, HIGH, MSIDE,
    STOPK, STOPQ, ECC, ECCP, WEAR, WEARS, IMB, IMBN, IMBP,
    BWK, BWT, DET, DETQ, DETW,
    INT, DEAD, ULAG, WAVE, MUP, FSP, D2P, CUBE, COG2, HARD, FLANKK,
    SLIP, SLIPS, ZERO,
) = range(len(COLUMNS))  # fmt: skip


@njit(cache=True, inline="always")
def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@njit(cache=True, inline="always")
def _add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@njit(cache=True, inline="always")
def _scaled(s, a):
    return (s * a[0], s * a[1], s * a[2])


@njit(cache=True, inline="always")
def _about_x(c, s, a):
    return (a[0], c * a[1] - s * a[2], s * a[1] + c * a[2])


@njit(cache=True, inline="always")
def _about_y(c, s, a):
    return (c * a[0] + s * a[2], a[1], -s * a[0] + c * a[2])


@njit(cache=True)
def leg_torque(q, v, a, gravity, link, out):
    """Joint torques (3,) of one leg for positions, velocities, accelerations; inverse dynamics.

    link (3, 13): mass, centre of mass (3), inertia about it xx yy zz xy xz yz, next joint (3); frames of the links.
    """
    c0, s0 = math.cos(q[0]), math.sin(q[0])
    c1, s1 = math.cos(q[1]), math.sin(q[1])
    c2, s2 = math.cos(q[1] + q[2]), math.sin(q[1] + q[2])  # hip and knee turn about the same axis
    # Axes of abad, and of hip and knee, in base axes.
    ax = (1.0, 0.0, 0.0)
    ay = (0.0, c0, s0)
    w = (0.0, 0.0, 0.0)
    dw = (0.0, 0.0, 0.0)
    acc = (-gravity[0], -gravity[1], -gravity[2])
    fx = np.empty((3, 9))  # force, moment about the joint's own origin, way to the next joint
    for i in range(3):
        axis = ax if i == 0 else ay
        spin = _scaled(v[i], axis)
        dw = _add(_add(dw, _scaled(a[i], axis)), _cross(w, spin))
        w = _add(w, spin)
        com = (link[i, 1], link[i, 2], link[i, 3])
        way = (link[i, 10], link[i, 11], link[i, 12])
        wl, dwl = w, dw
        # Into the frame of the link for its inertia, and back.
        wl, dwl = _about_x(c0, -s0, wl), _about_x(c0, -s0, dwl)
        if i == 1:
            wl, dwl = _about_y(c1, -s1, wl), _about_y(c1, -s1, dwl)
        elif i == 2:
            wl, dwl = _about_y(c2, -s2, wl), _about_y(c2, -s2, dwl)
        xx, yy, zz, xy, xz, yz = link[i, 4], link[i, 5], link[i, 6], link[i, 7], link[i, 8], link[i, 9]
        iw = (
            xx * wl[0] + xy * wl[1] + xz * wl[2],
            xy * wl[0] + yy * wl[1] + yz * wl[2],
            xz * wl[0] + yz * wl[1] + zz * wl[2],
        )
        n = (
            xx * dwl[0] + xy * dwl[1] + xz * dwl[2],
            xy * dwl[0] + yy * dwl[1] + yz * dwl[2],
            xz * dwl[0] + yz * dwl[1] + zz * dwl[2],
        )
        n = _add(n, _cross(wl, iw))
        if i == 1:
            n, com, way = _about_y(c1, s1, n), _about_y(c1, s1, com), _about_y(c1, s1, way)
        elif i == 2:
            n, com, way = _about_y(c2, s2, n), _about_y(c2, s2, com), _about_y(c2, s2, way)
        n, com, way = _about_x(c0, s0, n), _about_x(c0, s0, com), _about_x(c0, s0, way)
        f = _scaled(link[i, 0], _add(acc, _add(_cross(dw, com), _cross(w, _cross(w, com)))))
        n = _add(n, _cross(com, f))
        fx[i, 0], fx[i, 1], fx[i, 2] = f
        fx[i, 3], fx[i, 4], fx[i, 5] = n
        fx[i, 6], fx[i, 7], fx[i, 8] = way
        acc = _add(acc, _add(_cross(dw, way), _cross(w, _cross(w, way))))
    force = (0.0, 0.0, 0.0)
    moment = (0.0, 0.0, 0.0)
    for i in range(2, -1, -1):
        moment = _add(moment, _cross((fx[i, 6], fx[i, 7], fx[i, 8]), force))
        force = _add(force, (fx[i, 0], fx[i, 1], fx[i, 2]))
        moment = _add(moment, (fx[i, 3], fx[i, 4], fx[i, 5]))
        axis = ax if i == 0 else ay
        out[i] = axis[0] * moment[0] + axis[1] * moment[1] + axis[2] * moment[2]


@njit(cache=True)
def _inverted(a, n, w):
    """Inverse of a symmetric positive matrix (n, n) by Gauss-Jordan; a is overwritten."""
    for i in range(n):
        for j in range(n):
            w[i, j] = 1.0 if i == j else 0.0
    for i in range(n):
        p = 1.0 / a[i, i]
        for j in range(n):
            a[i, j] *= p
            w[i, j] *= p
        for r in range(n):
            if r != i:
                f = a[r, i]
                if f != 0.0:
                    for j in range(n):
                        a[r, j] -= f * a[i, j]
                        w[r, j] -= f * w[i, j]


@njit(cache=True)
def _stick_or_slide(w, low, high, v, impulse, n):
    """Friction impulses within low and high: v_i > 0 takes low, v_i < 0 takes high, 0 anything between. Changes v."""
    for i in range(n):
        impulse[i] = min(max(impulse[i], low[i]), high[i])
        for j in range(n):
            v[j] += w[j, i] * impulse[i]
    for _ in range(60):
        change = 0.0
        for i in range(n):
            if high[i] == low[i] and impulse[i] == low[i]:
                continue
            new = min(max(impulse[i] - v[i] / w[i, i], low[i]), high[i])
            d = new - impulse[i]
            if d != 0.0:
                impulse[i] = new
                for j in range(n):
                    v[j] += w[j, i] * d
                change = max(change, abs(d) * w[i, i])
        if change < 1e-12:
            break


@njit(cache=True)
def _between(torque, damp, v, v_mid):
    """Torque in the middle of a step, of one at its beginning that damping takes from."""
    return torque - damp * (v_mid - v)


@njit(cache=True)
def _read(p, x, travel, t):
    """What the encoder reads at angle x: a belt may jump a tooth, forth and back, and the zero may drift."""
    r = p[SCALE] * x + p[OFF] + p[ECC] * math.sin(x + p[ECCP]) + p[ZERO] * max(t, 0.0)
    if p[SLIP] != 0.0:
        r -= p[SLIP] * (math.floor(travel / p[SLIPS]) % 2.0)
    if p[STEP] > 0.0:
        r = p[STEP] * round(r / p[STEP])
    return r


@njit(cache=True)
def _limits(p, left, v):
    """Least and greatest torque of a motor at speed v with a share of its supply left."""
    tmax, vmax, flat = p[TMAX] * left, p[VMAX] * left, p[VFLAT] * left
    up = min(tmax, max(0.0, tmax * (vmax - v) / (vmax - flat)))
    down = -min(tmax, max(0.0, tmax * (vmax + v) / (vmax - flat)))
    return down, up


@njit(cache=True)
def _supply(drop, asked, speed, par):
    """Share of the supply that is left where what the motors then draw leaves it: the root of a falling function."""
    low, high = 0.2, 1.0
    for _ in range(20):
        left = 0.5 * (low + high)
        power = 0.0
        for l in range(asked.shape[0]):
            for j in range(3):
                down, up = _limits(par[l, j], left, speed[l, j])
                power += max(0.0, min(max(asked[l, j], down), up) * speed[l, j])
        if 1.0 - drop * power > left:
            low = left
        else:
            high = left
    return 0.5 * (low + high)


@njit(cache=True)
def run(dt, skip, every, rows, par, link, gravity, swing, drop, arrival, target, held, extra, extra_dt, q_out, tau_out):
    """Step all legs from rest at the held targets and write every ``every``-th state after ``skip`` steps.

    par (L, 3, columns); link (L, 3, 13); gravity (3,); swing (2, 3): amplitude [m/s^2], frequency, phase along x and
    y; drop [1/W]; arrival (L, 3, K) and target (L, 3, K): when each target takes effect and what it is, first one in
    effect from the start; held (L, 3); extra (N, L, 3): torque every extra_dt seconds. Time 0 is at row 0.
    q_out (rows, L, 3): what an ideal encoder would read there; tau_out (rows, L, 3): motor torque.
    """
    legs = par.shape[0]
    q, v = held.copy(), np.zeros((legs, 3))
    th, om = np.zeros((legs, 3)), np.zeros((legs, 3))
    v_old, om_old = np.zeros((legs, 3)), np.zeros((legs, 3))  # of the step before
    tau, lagged, seen, heat = np.zeros((legs, 3)), np.zeros((legs, 3)), np.zeros((legs, 3)), np.zeros((legs, 3))
    speed = np.zeros((legs, 3))  # of the step before, as the drive measures it
    travel, hyst, imp = np.zeros((legs, 3)), np.zeros((legs, 3)), np.zeros((legs, 6))
    goal, summed = held.copy(), np.zeros((legs, 3))
    at = np.zeros((legs, 3), np.int64)
    own = np.zeros((legs, 3), np.bool_)  # joints with a motor body of their own
    any_own = np.zeros(legs, np.bool_)
    for l in range(legs):
        for j in range(3):
            p = par[l, j]
            q[l, j] = (held[l, j] - p[OFF]) / p[SCALE]
            if p[GAP] > 0.0 or p[COMP] > 0.0:
                own[l, j] = True
                any_own[l] = True
            th[l, j] = q[l, j]
    qh, zero, unit, bias, column = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    m, a, w = np.zeros((3, 3)), np.zeros((6, 6)), np.zeros((6, 6))
    rhs, new, low, high, before = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    slot = np.zeros(3, np.int64)
    g, none = np.zeros(3), np.zeros(3)
    n_extra = extra.shape[0]
    asked, at_speed = np.zeros((legs, 3)), np.zeros((legs, 3))
    row = 0
    step = -skip
    while row < rows:
        t0 = step * dt
        if step >= 0 and step % every == 0:
            for l in range(legs):
                for j in range(3):
                    p = par[l, j]
                    x = th[l, j] if own[l, j] else q[l, j]
                    q_out[row, l, j] = _read(p, x, travel[l, j], t0)
                    tau_out[row, l, j] = tau[l, j]
            row += 1
        left = _supply(drop, asked, at_speed, par) if drop > 0.0 else 1.0
        for l in range(legs):
            parts = SUBSTEPS if any_own[l] else 1
            h = dt / parts
            for part in range(parts):
                t = t0 + part * h
                mid = t + 0.5 * h
                for k in range(3):
                    g[k] = gravity[k]
                for k in range(2):
                    g[k] += swing[k, 0] * math.sin(6.283185307179586 * swing[k, 1] * mid + swing[k, 2])
                for j in range(3):
                    qh[j] = q[l, j] + 0.5 * h * v[l, j]
                leg_torque(qh, v[l], zero, g, link[l], bias)
                for j in range(3):
                    unit[j] = 1.0
                    leg_torque(qh, zero, unit, none, link[l], column)
                    unit[j] = 0.0
                    for i in range(3):
                        m[i, j] = column[i]
                n = 3
                for i in range(6):
                    for j in range(6):
                        a[i, j] = 0.0
                for i in range(3):
                    for j in range(3):
                        a[i, j] = 0.5 * (m[i, j] + m[j, i])
                for j in range(3):
                    if own[l, j]:
                        slot[j] = n
                        n += 1
                    else:
                        slot[j] = j
                for j in range(3):
                    p = par[l, j]
                    s = slot[j]
                    is_own = own[l, j]
                    vj = v[l, j]
                    vm = om[l, j] if is_own else vj
                    # Velocities in the middle of the step, for what does not go with them in a straight line.
                    vj_mid = vj + 0.5 * (vj - v_old[l, j])
                    vm_mid = vm + 0.5 * (vm - om_old[l, j]) if is_own else vj_mid
                    xm = th[l, j] + 0.5 * h * vm if is_own else qh[j]
                    # Target in effect, averaged over the step.
                    last = arrival.shape[2] - 1
                    while at[l, j] < last and arrival[l, j, at[l, j] + 1] <= t:
                        at[l, j] += 1
                    u = target[l, j, at[l, j]]
                    share, jump = 0.0, 0.0
                    if at[l, j] < last and arrival[l, j, at[l, j] + 1] < t + h:
                        share = (t + h - arrival[l, j, at[l, j] + 1]) / h
                        jump = target[l, j, at[l, j] + 1] - u
                        u += share * jump
                    if p[ULAG] > 0.0:
                        old = goal[l, j]
                        goal[l, j] += (1.0 - math.exp(-h / p[ULAG])) * (u - old)
                        u, jump = 0.5 * (old + goal[l, j]), 0.0
                    # Encoder and drive.
                    r = _read(p, xm, travel[l, j], mid)
                    vr = (p[SCALE] + p[ECC] * math.cos(xm + p[ECCP])) * vm
                    stiff = p[KP] * p[SCALE]
                    damp = p[KD] * p[SCALE]
                    if p[STEP] > 0.0:
                        stiff = 0.0
                    if p[VLAG] > 0.0:
                        f = 1.0 - math.exp(-h / p[VLAG])
                        old = seen[l, j]
                        # In the middle of the step; else the filter is half a step later.
                        now = vr
                        vr += 0.5 * (vr - speed[l, j])
                        speed[l, j] = now
                        seen[l, j] += f * (vr - old)
                        vr = 0.5 * (old + seen[l, j])
                        damp = 0.0
                    factor = p[KT] * (1.0 + p[DRIFT] * mid / 100.0) * (1.0 - p[HLOSS] * heat[l, j])
                    error = u - r
                    if p[DEAD] > 0.0:
                        if abs(error) < p[DEAD]:
                            stiff = 0.0
                        error -= min(max(error, -p[DEAD]), p[DEAD])
                        jump = 0.0
                    summed[l, j] += h * error
                    cmd = factor * (p[KP] * error + p[INT] * summed[l, j] - p[KD] * vr)
                    jump *= factor * p[KP]
                    stiff *= factor
                    damp *= factor
                    if p[TLAG] > 0.0:
                        cmd = _between(cmd, damp, vm, vm_mid)
                        f = 1.0 - math.exp(-h / p[TLAG])
                        old = lagged[l, j]
                        lagged[l, j] += f * (cmd - old)
                        cmd = 0.5 * (old + lagged[l, j])
                        jump *= 0.5 * f
                        stiff = 0.0
                        damp = 0.0
                    asked[l, j], at_speed[l, j] = _between(cmd, damp, vm, vm_mid), vm_mid
                    down, up = _limits(p, left, vm_mid)
                    first, second = cmd - share * jump, cmd + (1.0 - share) * jump
                    if share > 0.0 and max(first, second) > down and min(first, second) < up:
                        # Each target of the step meets the limits by itself.
                        free = (1.0 - share) * (down <= first <= up) + share * (down <= second <= up)
                        cmd = (1.0 - share) * min(max(first, down), up) + share * min(max(second, down), up)
                        stiff, damp = free * stiff, free * damp
                    elif cmd > up:
                        cmd, stiff, damp = up, 0.0, 0.0
                    elif cmd < down:
                        cmd, stiff, damp = down, 0.0, 0.0
                    tau[l, j] = cmd
                    cmd_mid = _between(cmd, damp, vm, vm_mid)
                    heat[l, j] += h * (cmd * cmd - heat[l, j]) / p[HTIME]
                    # Inertia of the rotor; it may depend on the angle (not in the catalogue).
                    inertia = p[JA]
                    gyro = 0.0
                    if p[IMB] != 0.0:
                        inertia += p[IMB] * math.cos(p[IMBN] * xm + p[IMBP])
                        gyro = 0.5 * p[IMB] * p[IMBN] * math.sin(p[IMBN] * xm + p[IMBP]) * vm * vm
                    a[s, s] += inertia + 0.5 * h * damp + 0.25 * h * h * stiff
                    rhs[s] = cmd + gyro
                    # What acts on the link.
                    x = qh[j]
                    load = -bias[j]
                    d = p[D]
                    other = j + 1 if j < 2 else 1
                    load -= p[COUP] * (v[l, other] + 0.5 * (v[l, other] - v_old[l, other]))
                    load -= p[D2] * vj_mid * abs(vj_mid) ** p[D2P] + p[DA] * abs(vj_mid)
                    load += p[COGC] * math.cos(p[COGN] * x) + p[COGS] * math.sin(p[COGN] * x)
                    load += p[COG2] * math.cos(2.0 * p[COGN] * x)
                    load += p[MOM] - p[SPR] * x * (1.0 + p[CUBE] * x * x)
                    if p[PC] != 0.0 or p[PS] != 0.0:
                        phase = 6.283185307179586 * p[PF] * mid
                        load += p[PC] * math.cos(phase) + p[PS] * math.sin(phase)
                    if n_extra > 1:
                        place = max(0.0, mid / extra_dt)
                        k = min(int(place), n_extra - 2)
                        load += extra[k, l, j] + (place - k) * (extra[k + 1, l, j] - extra[k, l, j])
                    if p[STOPK] != 0.0 and x > p[STOPQ]:
                        load -= p[STOPK] * (x - p[STOPQ])
                    if p[DET] != 0.0:
                        y = (x - p[DETQ]) / p[DETW]
                        load -= p[DET] * y * math.exp(0.5 * (1.0 - y * y))
                    if p[BWT] != 0.0:
                        # Bouc-Wen: z' = v - |v| z / reach, torque = k z, reach = torque / k.
                        reach = p[BWT] / p[BWK]
                        z = hyst[l, j]
                        z += h * (vj - abs(vj) * z / reach)
                        hyst[l, j] = min(max(z, -reach), reach)
                        load -= p[BWK] * hyst[l, j]
                    if x > p[HIGH]:
                        load -= STOP_STIFFNESS * (x - p[HIGH]) + STOP_DAMPING * vj
                    elif x < p[LOW]:
                        load -= STOP_STIFFNESS * (x - p[LOW]) + STOP_DAMPING * vj
                    # Dry and viscous friction, on the link or on the motor.
                    f = s if p[MSIDE] > 0.0 else j
                    vf = vm_mid if p[MSIDE] > 0.0 else vj_mid
                    bound = p[FC] * (1.0 + p[WEAR] * math.exp(-travel[l, j] / p[WEARS]))
                    if p[FS] > 0.0:
                        bound += p[FS] * math.exp(-(abs(vf / p[VS]) ** p[FSP]))
                    if p[MU] != 0.0:
                        bound += p[MU] * abs(cmd_mid) ** p[MUP]
                    if p[WAVE] != 0.0:
                        bound = max(bound + p[WAVE] * math.cos(3.0 * x), 0.0)
                    travel[l, j] += h * abs(vf)
                    low[j], high[j] = 0.0, 0.0
                    if is_own:
                        low[s], high[s] = 0.0, 0.0
                    low[f], high[f] = -h * (bound + p[FA]), h * (bound - p[FA])
                    a[f, f] += 0.5 * h * d
                    if is_own:
                        rhs[j] = load
                        rhs[f] -= d * (vm if p[MSIDE] > 0.0 else vj)
                        # Between motor and link.
                        k = 1.0 / p[COMP] if p[COMP] > 0.0 else (p[FLANKK] if p[FLANKK] > 0.0 else FLANK)
                        c = 0.0 if p[COMP] > 0.0 else 2.0 * FLANK_DAMPING * math.sqrt(k * p[JA])
                        gap = 0.5 * p[GAP]
                        twist = xm - x
                        over = twist - gap if twist > gap else (twist + gap if twist < -gap else 0.0)
                        if p[HARD] > 0.0:
                            k *= 1.0 + (over / p[HARD]) ** 2
                        if over != 0.0 or gap == 0.0:
                            push = k * over + c * (vm - vj)
                            if push * over >= 0.0:
                                rhs[s] -= push
                                rhs[j] += push
                                soft = h * (0.5 * c + 0.25 * h * k)
                                a[s, s] += soft
                                a[j, j] += soft
                                a[s, j] -= soft
                                a[j, s] -= soft
                    else:
                        rhs[j] += load - d * vj
                _inverted(a, n, w)
                for i in range(n):
                    total = 0.0
                    for k in range(n):
                        total += w[i, k] * rhs[k]
                    new[i] = h * total
                for j in range(3):
                    new[j] += v[l, j]
                    before[j] = v[l, j]
                    if own[l, j]:
                        new[slot[j]] += om[l, j]
                _stick_or_slide(w, low, high, new, imp[l], n)
                for j in range(3):
                    q[l, j] = qh[j] + 0.5 * h * new[j]
                    v_old[l, j], om_old[l, j] = v[l, j], om[l, j]
                    v[l, j] = new[j]
                    if own[l, j]:
                        th[l, j] += 0.5 * h * (om[l, j] + new[slot[j]])
                        om[l, j] = new[slot[j]]
        step += 1
    return row

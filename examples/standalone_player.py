"""Play a policy without mimic: NumPy, SciPy, ONNX Runtime and MuJoCo, and what the ONNX file says about itself.

python examples/standalone_player.py policies/stand_track.onnx assets/cyberdog2/scene.xml
"""

import json
import sys

import mujoco
import numpy as np
import onnxruntime
import scipy.interpolate


def boxing(dt, seconds=8.0, period=1.2):
    """Return toe targets (N, 2, 3) [m]: left and right punch in turn, each out and back in a period [s]."""
    guard, punch = np.array([[0.06, 0.10, -0.14], [0.06, -0.10, -0.14]]), np.array([0.30, 0.0, -0.13])
    phase = np.arange(0.0, seconds, dt) / period
    out = np.sin(np.pi * (phase % 1.0)) ** 2
    turn = (phase.astype(int) % 2)[:, None] == np.arange(2)
    return guard + (out[:, None] * turn)[:, :, None] * (punch * [1, 1, 1] - guard * [1, 0, 1])


def arm_joints(model, toes):
    """Return joints (N, 6) [rad] that bring the front toes to targets (N, 2, 3) [m], by the closed form of a leg."""
    legs = []
    for leg, side in enumerate(("FL", "FR")):
        x, y, z = (toes[:, leg] - model.body(f"{side}_abad").pos).T
        offset, thigh = model.body(f"{side}_hip").pos[1], -model.body(f"{side}_knee").pos[2]
        toe_x, _, toe_z = model.site(f"{side}_toe").pos
        shank, lean = np.hypot(toe_x, toe_z), np.arctan2(-toe_x, -toe_z)
        depth = np.sqrt(y * y + z * z - offset**2)
        bend = -np.arccos((x * x + depth * depth - thigh**2 - shank**2) / (2 * thigh * shank))
        abad = np.arctan2(z, y) - np.arctan2(-depth, offset)
        hip = np.arctan2(-x, depth) - np.arctan2(shank * np.sin(bend), thigh + shank * np.cos(bend))
        legs += [np.angle(np.exp(1j * abad)), np.angle(np.exp(1j * hip)), bend - lean]
    return np.stack(legs, 1)


def arm_targets(model, data, c, q, dq, ddq):
    """Return position targets (6,) [rad] that keep the arms in a motion: q + (kd dq + tau) / kp."""
    other, torque = mujoco.MjData(model), np.zeros(18)
    other.qpos[:], other.qpos[7:13], other.qvel[6:12], other.qacc[6:12] = data.qpos, q, dq, ddq
    mujoco.mj_step1(model, other)
    mujoco.mj_rne(model, other, 1, torque)
    damping, dry, rotor = (v[6:12] for v in (model.dof_damping, model.dof_frictionloss, model.dof_armature))
    torque = torque[6:12] + rotor * ddq + damping * dq + dry * dq / (np.abs(dq) + 0.1)
    return q + (np.array(c["kd"][:6]) * dq + torque) / c["kp"][:6]


def play(policy, model_path, toes, stand_seconds=2.0):
    """Yield (t, q, quat, q_des) while a robot lying on the ground stands up and follows toe targets (N, 2, 3)."""
    session = onnxruntime.InferenceSession(policy)
    c = json.loads(session.get_modelmeta().custom_metadata_map["mimic_contract"])
    default, scale, low, high = (np.array(c[k]) for k in ("default_q", "action_scale", "q_min", "q_max"))
    spec = mujoco.MjSpec.from_file(model_path)
    for motor in spec.actuators:
        motor.delay = motor.nsample = 0  # the delay is played below, from the contract
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = [0, 0, 0.1412, 1, 0, 0, 0, *(folded := np.tile([0.0, 1.3963, -2.3562], 4))]
    substeps, late = round(c["dt"] / model.opt.timestep), round(c["delay"] / model.opt.timestep)
    stand, blend, tick = round(stand_seconds / c["dt"]), c["blend_steps"], 2 * np.pi * c["clock_hz"] * c["dt"]
    frames, slow, action, gait, sent = None, None, np.zeros(12), 0.0, [folded] * 3
    for k in range(stand + blend + len(toes)):
        q, (w, x, y, z) = data.qpos[7:].copy(), data.qpos[3:7].copy()
        heading = np.arctan2(-2 * (x * y - w * z), 1 - 2 * (x * x + z * z))
        if k == stand:
            arms, share = arm_joints(model, toes), np.arange(blend)[:, None] / blend
            rows = np.vstack([q[:6] + share**2 * (3 - 2 * share) * (arms[0] - q[:6]), arms, arms[-1:]])
            times = c["dt"] * (np.arange(len(rows)) - blend)
            path = scipy.interpolate.CubicSpline(times, rows, bc_type="clamped")
        since = c["dt"] * (k - stand - blend)
        once = np.zeros((4, 12))
        if k >= stand:  # where the arms will be
            t = np.minimum(since + np.array([0.0, 0.1, 0.2, 0.3]), times[-1])
            once = np.hstack([path(t) - default[:6], 0.05 * path(t, 1) * (t < times[-1])[:, None]])
        down = -2 * (x * z - w * y), -2 * (y * z + w * x), -(1 - 2 * (x * x + y * y))
        forward = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        steps = 1 if abs(heading) > c["walk_turn"] * (1 - gait / 2) else -1
        gait = np.clip(gait + steps * c["dt"] / c["clock_fade"], 0, 1) if c["clock_fade"] else 1.0
        clock = gait * np.array([np.sin(k * tick), np.cos(k * tick)])
        turn = np.clip([-heading], -1, 1)
        frame = np.concatenate([q - default, down, forward, action, [0, 0], turn, clock])
        turning, moving = np.clip(0.25 * data.qvel[3:6], -5, 5), np.clip(0.05 * data.qvel[6:], -2, 2)
        now = np.concatenate([frame[:18], frame[30:32]])  # joint_position, down, forward, velocity_command
        slow = now if slow is None else slow + (now - slow) * c["dt"] / 3
        row = np.concatenate([frame, turning, moving, slow])
        frames = np.tile(row, (c["history"], 1)) if frames is None else np.vstack([frames[1:], row])
        seen = np.concatenate([frames.ravel(), once.ravel(), [1.0]]).astype(np.float32)
        (answer,) = session.run(None, {"observation": seen[None]})
        action = np.clip(answer[0].astype(float), -c["action_clip"], c["action_clip"])
        sent = [np.clip(default + scale * action, low, high), *sent[:2]]
        if k >= stand:
            action[:6] = 0.0  # the network does not move the arms
            t = since + c["delay"] + c["dt"] * (1 if c["interpolate"] else 0.5)
            moves = [path(min(t, times[-1]), order) * (order == 0 or t < times[-1]) for order in range(3)]
            sent[0][:6] = arm_targets(model, data, c, *moves)
        yield k * c["dt"], q, np.array([w, x, y, z]), sent[0]
        for step in range(substeps):
            way = (step + 1 - late) / substeps if c["interpolate"] else float(step >= late)
            old, new, way = (sent[1], sent[0], way) if way > 0 else (sent[2], sent[1], way + 1)
            data.ctrl[:] = old + min(way, 1) * (new - old)
            mujoco.mj_step(model, data)


if __name__ == "__main__":
    policy, scene = sys.argv[1:] if len(sys.argv) == 3 else sys.exit(__doc__)
    for t, _, (w, x, y, z), _ in play(policy, scene, boxing(0.02)):
        print(f"{t:5.2f} s  base x points {np.degrees(np.arcsin(np.clip(2 * (x * z - w * y), -1, 1))):3.0f}° upward")

"""The way of the targets to the drive."""

from mimic.dynamics.catalogue.kinds import Effect, Parameter

COMMANDS = (
    Effect(
        name="joint_delay",
        title="extra delay of a joint",
        equation="the target of this joint acts time later than those of the others",
        parameters=(Parameter("time", "s", low=0.0, high=0.1, step=0.001, spread=30, starts=(4.0, 12.0)),),
        signature="residual of one joint in proportion to the speed of its target",
        experiment="steps and a chirp",
        enters="command path; actuator delay in MJCF",
        source="place on the bus",
    ),
    Effect(
        name="delay_jitter",
        title="jittering delay",
        equation="each target acts later by a time drawn between 0 and spread",
        parameters=(Parameter("spread", "s", low=0.0, high=0.1, step=0.002),),
        scope="machine",
        random=True,
        signature="bursts on the grid of the targets, in proportion to their change",
        experiment="arrival times in the log",
        enters="command path",
        source="a computer without real time",
    ),
    Effect(
        name="lost_commands",
        title="lost commands",
        equation="each target is lost with probability share; the one before stays",
        parameters=(Parameter("share", "1", low=0.0, high=0.9, step=0.01),),
        scope="machine",
        random=True,
        signature="bursts on the grid of the targets, as if a target had been left out",
        experiment="frame counters in the log",
        enters="command path",
        source="bus errors",
    ),
    Effect(
        name="target_filter",
        title="low-pass on the target",
        equation="the drive follows w, time dw/dt + w = target",
        parameters=(Parameter("time", "s", low=0.0, high=0.5, step=0.001, spread=50, starts=(5.0, 20.0, 60.0)),),
        signature="steps of the target arrive rounded; later than a delay, and only for what is fast",
        experiment="steps",
        enters="command path",
        source="profiles and smoothing in servo firmware",
    ),
)

"""Friction beyond dry and viscous."""

from mimic.dynamics.catalogue.kinds import STANDARD, Effect, Parameter

FRICTION = (
    Effect(
        name="stribeck",
        title="Stribeck friction",
        equation="tau = -level exp(-(v/speed)^2) sgn(v), beside dry friction",
        parameters=(
            Parameter(name="level", unit="N m", neutral=0.0, low=0.0, high=50.0, step=0.01, starts=(15.0,)),
            Parameter(
                name="speed",
                unit="rad/s",
                neutral=0.1,
                low=0.005,
                high=2.0,
                step=0.01,
                starts=(2.0, 6.0, 20.0),
                shape=True,
                spread=30,
            ),
        ),
        structural=True,
        signature="spikes at each start, stick-slip",
        experiment="repeat with slow ramps below 0.05 rad/s and small reversals",
        enters="dof_frictionloss at every step; dcmotor lugre in MJCF",
        source="Stribeck 1902; Armstrong-Helouvry et al. 1994",
    ),
    Effect(
        name="load_friction",
        title="load-dependent friction",
        equation="tau = -ratio |tau_motor| sgn(v), beside dry friction",
        parameters=(
            Parameter(name="ratio", unit="1", neutral=0.0, low=0.0, high=0.9, step=0.02, spread=25, starts=(5.0,)),
        ),
        signature="friction grows in loaded poses",
        experiment="reversals under several loads",
        enters="dof_frictionloss at every step",
        source="gear efficiency; Duclos et al., bam, 2025",
    ),
    Effect(
        name="gear_load_friction",
        title="load-dependent friction of the gear",
        equation="tau = -ratio |tau_motor - tau_external| sgn(v), beside dry friction; tau_external: gravity, motion",
        parameters=(
            Parameter(name="ratio", unit="1", neutral=0.0, low=0.0, high=0.9, step=0.02, spread=25, starts=(5.0,)),
        ),
        signature="friction grows in loaded poses, also where the link pushes the motor that is switched off",
        experiment="reversals under several loads, and falls with the drive switched off",
        enters="dof_frictionloss at every step",
        source="gear meshes carry both torques; Duclos et al., bam, 2025",
    ),
    Effect(
        name="asymmetric_friction",
        title="asymmetric friction",
        equation="tau = -level - coefficient |v|, beside dry (at most as much of it, at rest too) and viscous friction",
        parameters=(
            Parameter(name="level", unit="N m", neutral=0.0, low=-50.0, high=50.0, step=0.01),
            Parameter(name="coefficient", unit="N m s/rad", neutral=0.0, low=-500.0, high=500.0, step=0.01),
        ),
        signature="mean error differs between the two directions",
        experiment="equal ramps both ways",
        enters="dof_frictionloss and qfrc_applied at every step",
        source="Janot, Gautier, Brunot 2019, EMPS",
    ),
    Effect(
        name="quadratic_drag",
        title="quadratic drag",
        equation="tau = -coefficient v |v|",
        parameters=(Parameter(name="coefficient", unit="N m s^2/rad^2", neutral=0.0, low=0.0, high=50.0, step=0.01),),
        signature="lag that grows with the square of speed",
        experiment="fast sines",
        enters="qfrc_applied at every step; damping polynomial in MJCF",
        source=STANDARD,
    ),
    Effect(
        name="coupling",
        title="coupling to the neighbouring joint",
        equation="tau = -coefficient v of the next joint of the chain (of the one before, for the last)",
        parameters=(Parameter(name="coefficient", unit="N m s/rad", neutral=0.0, low=-50.0, high=50.0, step=0.01),),
        signature="residual follows the other joint's speed",
        experiment="one joint at a time, then together",
        enters="qfrc_applied at every step",
        source="belts, shared bearings and cable looms",
    ),
)

"""The control loop: it plays commands on a plant through a policy, supervised at every tick."""

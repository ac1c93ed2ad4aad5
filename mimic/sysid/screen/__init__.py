"""Which effects a log asks for, by regression of the torque: seconds, where replays take minutes."""

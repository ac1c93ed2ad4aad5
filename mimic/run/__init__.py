"""Playing commands on a plant: the loop, the plants, and the judging of policies."""

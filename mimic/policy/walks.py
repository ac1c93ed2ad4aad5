"""How fast a policy walks when it is asked for a speed: ``[walks]`` in the .toml beside its ONNX file, measured."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from mimic.config.values import read_toml
from mimic.errors import ConfigError
from mimic.records import CommandTrack

FIELDS = ("asked", "walked", "lost")
"""Speed that is asked for and that it walks with [m/s], in rising order; time that it loses to get going [s].

``reversed`` has the time that it loses [s] where it walked forward before it walks back, and the other way round.
"""


def corrected(commands: CommandTrack, policy: Path) -> CommandTrack:
    """Return commands with the velocities that a policy must be asked for to walk as far as they say.

    Each stretch of one velocity is a walk, whose distance is its velocity times its duration. Without a measured table,
    and beyond it, velocities stay within what is measured or as they are.

    Raises:
        ConfigError: If the table is not one of rising speeds.
    """
    file = policy.with_suffix(".toml")
    table = read_toml(file).get("walks", {}) if file.is_file() else {}
    if not table:
        return commands
    rows = [np.asarray(table.get(name, []), dtype=np.float64) for name in FIELDS]
    asked, walked, lost = rows
    if len({len(row) for row in rows}) > 1 or len(asked) < 2 or np.any(np.diff([asked, walked]) <= 0.0):
        raise ConfigError(f"{file.name}: [walks] needs {', '.join(FIELDS)} of the same length, the first two rising")
    v = commands.v.copy()
    dt = float(commands.t[1] - commands.t[0]) if len(commands.t) > 1 else 0.0
    edges = np.flatnonzero(np.diff(v[:, 0], prepend=np.nan, append=np.nan))
    before = 0.0
    for start, end in pairwise(edges):
        wanted = v[start, 0]
        seconds = dt * (end - start)
        loses = float(np.interp(wanted, walked, lost))
        if before * wanted < 0.0:
            loses = float(table.get("reversed", (loses, loses))[int(wanted > 0.0)])
        if wanted != 0.0:
            v[start:end, 0] = np.interp(wanted * seconds / max(seconds - loses, 0.5 * seconds), walked, asked)
        before = wanted
    return replace(commands, v=v)

"""Where a Go2 is and how its messages map to the joints: ``assets/go2/board.toml``, or your copy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mimic.errors import ConfigError
from mimic.hardware.robot.board_wiring import JointWiring, read_board
from mimic.hardware.toml_fields import whole

BOARD = "go2"


@dataclass(frozen=True, kw_only=True, eq=False)
class Go2Wiring(JointWiring):
    """Domain, order and signs of a Go2. Joint arrays are (12,) in the order of JOINTS."""

    domain: int
    """Of DDS."""
    motion_switcher: bool
    """Whether it has the service that releases its sport mode; a simulator may have none."""


def load_go2(path: Path | None = None) -> Go2Wiring:
    """Read the wiring of a Go2.

    Args:
        path: File; None takes the one that ships with the robot.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML or not consistent.
    """
    return read_board(Go2Wiring, BOARD, path, _own_fields)


def _own_fields(raw: Mapping[str, Any]) -> dict[str, Any]:
    switcher = raw.get("motion_switcher")
    if not isinstance(switcher, bool):
        raise ConfigError(f"motion_switcher is {switcher!r}; expected true, or false for a simulator without it")
    return {"domain": whole(raw, "domain", "the file", 0, 230), "motion_switcher": switcher}

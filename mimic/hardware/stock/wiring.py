"""Where a stock CyberDog 2 is and how its messages map to the joints: ``assets/cyberdog2/board.toml``, or your copy."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import ConfigError
from mimic.hardware.robot.board_wiring import JointWiring, numbers, read_board
from mimic.hardware.toml_fields import number, table, whole
from mimic.records import LEGS, FloatArray

BOARD = "cyberdog2"


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardWiring(JointWiring):
    """Addresses, order and signs of a board. Joint arrays are (12,) in the order of JOINTS."""

    address: str
    """Multicast group."""
    port: int
    state_port: int
    """Of the orientation."""
    ttl: int
    temperature_unit: float
    """[degC]"""
    cut: FloatArray
    """Largest distance of a desired position from the measured one that the firmware lets pass (12,) [rad]."""
    cut_margin: float
    """Distance that mimic keeps from it [rad]."""


def load_board(path: Path | None = None) -> BoardWiring:
    """Read the wiring of a board.

    Args:
        path: File; None takes the one that ships with the robot.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML or not consistent.
    """
    return read_board(BoardWiring, BOARD, path, _own_fields)


def _own_fields(raw: Mapping[str, Any]) -> dict[str, Any]:
    limits = table(raw, "limits", "the file")
    margin = number(limits, "cut_margin", "[limits]")
    cut = numbers(limits, "cut")
    if min(cut) <= margin or margin < 0.0:
        raise ConfigError(f"cut_margin of [limits] is {margin:g} rad; expected less than each cut: {cut}")
    return {
        "address": _group(raw),
        "port": whole(raw, "port", "the file", 1, 0xFFFF),
        "state_port": whole(raw, "state_port", "the file", 1, 0xFFFF),
        "ttl": whole(raw, "ttl", "the file", 0, 255),
        "temperature_unit": number(raw, "temperature_unit", "the file"),
        "cut": np.tile(cut, len(LEGS)),
        "cut_margin": margin,
    }


def _group(raw: Mapping[str, Any]) -> str:
    given = raw.get("address")
    try:
        if ipaddress.IPv4Address(given).is_multicast:  # type: ignore[arg-type]
            return str(given)
    except ValueError:
        pass
    raise ConfigError(f"address is {given!r}; expected a multicast group, such as 239.255.76.67")

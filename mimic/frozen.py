"""The dataclasses of mimic: frozen, and made by the names of their fields."""

from __future__ import annotations

from dataclasses import dataclass, field, is_dataclass
from typing import TypeVar, dataclass_transform

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def frozen(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass of plain values, which is equal to another one with the same values."""
    return dataclass(frozen=True, kw_only=True)(cls)


@dataclass_transform(eq_default=False, frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def frozen_arrays(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass that holds arrays: equal to itself only, and shown as a base class says."""
    shown = cls.__repr__ is object.__repr__ or is_dataclass(cls.__base__)
    return dataclass(frozen=True, kw_only=True, eq=False, repr=shown)(cls)

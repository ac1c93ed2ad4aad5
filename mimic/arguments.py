"""Refuses an argument of a public function that is of another kind than its annotation says."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from numbers import Real
from types import UnionType
from typing import Any, get_args, get_origin

from mimic.errors import ConfigError


def checked(function: Callable[..., Any], names: Callable[[str], Any] = lambda name: None) -> Callable[..., Any]:
    """Return a function that first looks at the kinds of its arguments.

    Args:
        function: A function whose annotations are strings.
        names: Gives what stands for a name that its module imports for type checkers only; None where that is unknown,
            and what is annotated so is not looked at.
    """
    signature = inspect.signature(function)
    kinds = {name: _kind(p.annotation, function, names) for name, p in signature.parameters.items()}

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            given = signature.bind(*args, **options).arguments
        except TypeError:
            return function(*args, **options)  # whose own error names it
        for name, value in given.items():
            if not _fits(value, kinds[name]):
                found = type(value).__name__
                of = function.__qualname__.removesuffix(".__init__")
                raise ConfigError(f"{of}: {name} is a {found}; expected {_said(kinds[name])}")
        return function(*args, **options)

    return call


def _kind(annotation: Any, function: Callable[..., Any], names: Callable[[str], Any]) -> Any:
    """Return what an annotation means; Any where that is not known."""
    if not isinstance(annotation, str):  # there is none
        return Any
    module = vars(sys.modules[function.__module__])
    words = set(re.findall(r"[A-Za-z_]\w*", annotation)) - module.keys()
    found = {word: names(word) for word in words}
    try:
        return eval(annotation, module, {word: kind for word, kind in found.items() if kind is not None})
    except NameError:
        return Any


def _fits(value: Any, kind: Any) -> bool:
    if isinstance(kind, UnionType):
        return any(_fits(value, part) for part in get_args(kind))
    if kind is Any or getattr(kind, "_is_protocol", False):
        return True
    origin = get_origin(kind)
    if origin is Sequence:
        return isinstance(value, Sequence) and all(_fits(item, get_args(kind)[0]) for item in value)
    return isinstance(value, Real if kind is float else origin or kind)


def _said(kind: Any) -> str:
    if isinstance(kind, UnionType):
        return " or ".join(map(_said, get_args(kind)))
    origin = get_origin(kind)
    if origin is Sequence:
        return f"a sequence of {_said(get_args(kind)[0])}"
    return (origin or kind).__name__.replace("NoneType", "None")

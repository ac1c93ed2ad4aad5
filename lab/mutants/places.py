"""Places in code where one token can be changed, and what it becomes.

A place is a token in a file's code: an operator, a comparison, `and`, `or`, `not`, a number, True or False, or the name
of a constant. Docstrings and other texts, f-strings, annotations, comments and imports have no places.
"""

from __future__ import annotations

import ast
import io
import random
import re
import tokenize
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

OPERATORS = {
    "+": "-",
    "-": "+",
    "*": "/",
    "/": "*",
    "//": "*",
    "%": "*",
    "**": "*",
    "@": "*",
    "&": "|",
    "|": "&",
    "^": "&",
    "<<": ">>",
    ">>": "<<",
    "~": "-",
}
"""What an operator becomes, alone or before `=`."""

WORDS = {
    "<": ("<=", ">"),
    "<=": ("<", ">"),
    ">": (">=", "<"),
    ">=": (">", "<"),
    "==": ("!=",),
    "!=": ("==",),
    "is": ("is not",),
    "is not": ("is",),
    "in": ("not in",),
    "not in": ("in",),
    "and": ("or",),
    "or": ("and",),
    "not": ("",),
    "True": ("False",),
    "False": ("True",),
}
"""What a comparison or a word becomes."""

CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]+")
"""Name of a constant."""

Position = tuple[int, int]
"""Line from 1 and column from 0, in characters."""


@dataclass(frozen=True)
class Place:
    """A token that can be changed."""

    file: str
    """Path from the root of the tree."""
    line: int
    column: int
    before: str
    choices: tuple[str, ...]
    """What it may become."""


@dataclass(frozen=True)
class Mutant:
    """A token and what it becomes."""

    file: str
    line: int
    column: int
    before: str
    after: str

    def of(self, source: str) -> str:
        """Return the source with the token changed."""
        lines = source.split("\n")
        line = lines[self.line - 1]
        end = self.column + len(self.before)
        if line[self.column : end] != self.before:
            raise ValueError(f"{self.file}:{self.line} does not have {self.before!r} at column {self.column}")
        lines[self.line - 1] = line[: self.column] + self.after + line[end:]
        return "\n".join(lines)


class _Finder(ast.NodeVisitor):
    """Collects the places of one file."""

    def __init__(self, file: str, source: str) -> None:
        self.file = file
        self.lines = source.split("\n")
        self.found: list[Place] = []
        tree = ast.parse(source)
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        self.tokens = [t for t in tokens if t.type in (tokenize.OP, tokenize.NAME)]
        self.starts = [token.start for token in self.tokens]
        self.names = _names(tree)
        self.attributes = _attributes(tree)
        self.visit(tree)

    # What has no places.

    def visit_Import(self, node: ast.Import) -> None: ...

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None: ...

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None: ...

    def visit_arg(self, node: ast.arg) -> None: ...

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value:
            self.visit(node.value)

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        for part in (*node.decorator_list, node.args, *node.body):
            self.visit(part)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
        self.visit_FunctionDef(node)

    # What has one.

    def visit_BinOp(self, node: ast.BinOp) -> None:
        self._operator(self._end(node.left), self._start(node.right))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._operator(self._end(node.target), self._start(node.value))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not):
            self._word(self._start(node), self._start(node.operand))
        else:
            self._operator(self._start(node), self._start(node.operand))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._word(self._end(left), self._start(right))
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, right in zip([node.left, *node.comparators], node.comparators, strict=False):
            self._word(self._end(left), self._start(right))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool):
            self._add(self._start(node), str(node.value), WORDS[str(node.value)])
        elif isinstance(node.value, int | float):
            line, start = self._start(node)
            _, end = self._end(node)
            self._add((line, start), self.lines[line - 1][start:end], _numbers(node.value))

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Load) and CONSTANT.fullmatch(node.id):
            self._add(self._start(node), node.id, tuple(self.names - {node.id}))

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if isinstance(node.ctx, ast.Load) and CONSTANT.fullmatch(node.attr):
            line, end = self._end(node)
            others = self.attributes[ast.unparse(node.value)] - {node.attr}
            self._add((line, end - len(node.attr)), node.attr, tuple(others))
        self.generic_visit(node)

    # Where it is.

    def _position(self, line: int, column: int) -> Position:
        """Return a position in characters; the syntax tree counts bytes."""
        return line, len(self.lines[line - 1].encode()[:column].decode())

    def _start(self, node: ast.expr) -> Position:
        return self._position(node.lineno, node.col_offset)

    def _end(self, node: ast.expr) -> Position:
        return self._position(node.end_lineno or node.lineno, node.end_col_offset or node.col_offset)

    def _between(self, start: Position, end: Position) -> list[tokenize.TokenInfo]:
        """Return the operators and words between two operands, without brackets."""
        inside = self.tokens[bisect_left(self.starts, start) : bisect_left(self.starts, end)]
        return [token for token in inside if token.string not in "()"]

    def _operator(self, start: Position, end: Position) -> None:
        for token in self._between(start, end)[:1]:
            text = token.string
            plain = text.removesuffix("=")
            if plain in OPERATORS:
                self._add(token.start, text, (OPERATORS[plain] + text[len(plain) :],))

    def _word(self, start: Position, end: Position) -> None:
        words = self._between(start, end)
        text = " ".join(token.string for token in words)
        if text in WORDS:
            self._add(words[0].start, text, WORDS[text])

    def _add(self, start: Position, before: str, choices: tuple[str, ...]) -> None:
        if choices:
            self.found.append(Place(self.file, *start, before, tuple(sorted(choices))))


def _numbers(value: float) -> tuple[str, ...]:
    """Return what a number becomes: an integer one more or one less, another one twice or half of it."""
    if value == 0:
        return ("1",)
    if isinstance(value, int):
        return (str(value + 1), str(value - 1))
    return (repr(value * 2), repr(value / 2))


def _names(tree: ast.Module) -> set[str]:
    """Return the names of constants that a module assigns or imports."""
    names: set[str] = set()
    for node in tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                names.add(name)
            case ast.ImportFrom():
                names |= {one.asname or one.name for one in node.names}
    return {name for name in names if CONSTANT.fullmatch(name)}


def _attributes(tree: ast.Module) -> dict[str, set[str]]:
    """Return, for each object, its constants that a module reads."""
    found: dict[str, set[str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and CONSTANT.fullmatch(node.attr):
            found.setdefault(ast.unparse(node.value), set()).add(node.attr)
    return found


def places(root: Path) -> Iterator[Place]:
    """Yield all places of mimic/ below a root, by file, line and column."""
    for path in sorted((root / "mimic").rglob("*.py")):
        finder = _Finder(str(path.relative_to(root)), path.read_text(encoding="utf-8"))
        yield from sorted(finder.found, key=lambda place: (place.line, place.column))


def drawn(root: Path, seed: int) -> Iterator[Mutant]:
    """Yield mutants in random order: any place as likely as any other, and any choice of a place."""
    every = list(places(root))
    chance = random.Random(seed)
    for place in chance.sample(every, len(every)):
        yield Mutant(place.file, place.line, place.column, place.before, chance.choice(place.choices))

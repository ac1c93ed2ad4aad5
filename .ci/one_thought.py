"""One thought a line: counts, in the code of mimic, what packs several into one, and holds each count at its limit.

    python .ci/one_thought.py [--show]   # --show names every place

A limit may only fall. `COMPLEX` names the functions above radon's grade C that are left; nobody may join them.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

LIMITS = {
    "tuple assignment of unrelated values": 0,
    "comprehension in a comprehension": 3,
    "walrus inside a larger expression": 5,
}
"""What may be found in mimic/, at the most; all of it is in sysid."""

MOST_COMPLEX = 20
"""Cyclomatic complexity of a function, as radon counts it; its grade C ends here."""

COMPLEX = (
    "mimic/sysid/log/checks.py:_readable",
    "mimic/sysid/log/pool.py:pool",
)
"""Functions that are above it."""

COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def tuple_assignments(tree: ast.Module) -> Iterator[int]:
    """Yield the lines of assignments of a tuple to a tuple, other than swaps."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            for target in node.targets:
                if isinstance(target, ast.Tuple) and not _swaps(target, node.value):
                    yield node.lineno


def _swaps(target: ast.Tuple, value: ast.Tuple) -> bool:
    return {ast.unparse(one) for one in target.elts} == {ast.unparse(one) for one in value.elts}


def nested_comprehensions(tree: ast.Module) -> Iterator[int]:
    """Yield the lines of comprehensions that hold another one."""
    for node in ast.walk(tree):
        if isinstance(node, COMPREHENSIONS):
            inner = [one for one in ast.walk(node) if one is not node and isinstance(one, COMPREHENSIONS)]
            if inner:
                yield node.lineno


def inner_walruses(tree: ast.Module) -> Iterator[int]:
    """Yield the lines of assignment expressions that are neither a condition nor one side of its comparison."""
    fine: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If | ast.While):
            fine.add(node.test)
            if isinstance(node.test, ast.Compare):
                fine.add(node.test.left)
    for node in ast.walk(tree):
        if isinstance(node, ast.NamedExpr) and node not in fine:
            yield node.lineno


RULES = dict(zip(LIMITS, (tuple_assignments, nested_comprehensions, inner_walruses), strict=True))


def complexity(function: ast.AST) -> int:
    """Return the cyclomatic complexity of a function and the functions inside it, as radon counts it."""
    return 1 + sum(_branches(node) for node in ast.walk(function) if node is not function)


def _branches(node: ast.AST) -> int:
    match node:
        case ast.BoolOp():
            return len(node.values) - 1
        case ast.If() | ast.IfExp() | ast.Assert() | ast.FunctionDef() | ast.AsyncFunctionDef():
            return 1
        case ast.For() | ast.AsyncFor() | ast.While():
            return 1 + bool(node.orelse)
        case ast.Try() | ast.TryStar():
            return len(node.handlers) + bool(node.orelse)
        case ast.comprehension():
            return 1 + len(node.ifs)
        case ast.Match():
            return sum(not _catches_all(case) for case in node.cases)
    return 0


def _catches_all(case: ast.match_case) -> bool:
    return isinstance(case.pattern, ast.MatchAs) and case.pattern.pattern is None


def functions(tree: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Yield the functions of a module and the methods of its classes, with their names."""
    for node in tree.body:
        if isinstance(node, FUNCTIONS):
            yield node.name, node
        elif isinstance(node, ast.ClassDef):
            for method in node.body:
                if isinstance(method, FUNCTIONS):
                    yield f"{node.name}.{method.name}", method


def main() -> int:
    """Count, compare with the limits, and say what is wrong; return the exit status."""
    places: dict[str, list[str]] = defaultdict(list)
    complex_ones: dict[str, int] = {}
    for path in sorted((ROOT / "mimic").rglob("*.py")):
        name = str(path.relative_to(ROOT))
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for rule, found in RULES.items():
            places[rule] += [f"{name}:{line}" for line in found(tree)]
        for function, node in functions(tree):
            if complexity(node) > MOST_COMPLEX:
                complex_ones[f"{name}:{function}"] = complexity(node)
    wrong = []
    for rule, limit in LIMITS.items():
        count = len(places[rule])
        print(f"{count:4d} x {rule} (limit {limit})")
        if count != limit:
            wrong.append(f"{rule}: {count}, not {limit}; {'lower the limit' if count < limit else 'split the lines'}")
        if "--show" in sys.argv:
            print("\n".join(f"    {place}" for place in places[rule]))
    print(f"{len(complex_ones):4d} x function above complexity {MOST_COMPLEX} (limit {len(COMPLEX)})")
    wrong += [f"{name} has complexity {complex_ones[name]}: split it" for name in sorted({*complex_ones} - {*COMPLEX})]
    wrong += [
        f"{name} is below {MOST_COMPLEX} now: take it from COMPLEX" for name in sorted({*COMPLEX} - {*complex_ones})
    ]
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

"""What a first start has to compile."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import mapmyworld

ROOT = Path(mapmyworld.__file__).parent


def kernels() -> Iterator[tuple[Path, ast.FunctionDef]]:
    """Every function that a decorator compiles."""
    for path in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef) and any(
                "jit" in ast.unparse(decorator) for decorator in node.decorator_list
            ):
                yield path, node


def copied_slices(function: ast.FunctionDef) -> list[str]:
    """Assignments of one array to a slice of another, of the same shape or not."""
    return [
        ast.unparse(node)
        for node in ast.walk(function)
        if isinstance(node, ast.Assign)
        and any(isinstance(n, ast.Slice) for target in node.targets for n in ast.walk(target))
        and not all(isinstance(n, ast.Constant) for n in values_of(node.value))
    ]


def values_of(value: ast.expr) -> list[ast.expr]:
    return value.elts if isinstance(value, ast.Tuple) else [value]


def test_no_kernel_assigns_an_array_to_a_slice() -> None:
    """It would compile the text of a shape error, for five seconds; `assign` does not."""
    found = list(kernels())
    assert len(found) > 100
    assert {path.name: copied_slices(f) for path, f in found if copied_slices(f)} == {}

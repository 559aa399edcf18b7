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
    """It would compile the text of a shape error, for five seconds; number by number does not."""
    found = list(kernels())
    assert len(found) > 50
    assert {path.name: copied_slices(f) for path, f in found if copied_slices(f)} == {}


def test_no_inner_kernel_is_called_from_python() -> None:
    """It has no way in: the call would end the process."""
    inner: dict[str, set[Path]] = {}
    for path, function in kernels():
        if "inner_jit" in map(ast.unparse, function.decorator_list):
            inner.setdefault(function.name, set()).add(path)
    assert len(inner) > 30
    for folder in ("mapmyworld", "formats", "cli", "tests", "benchmarks"):
        for path in sorted((ROOT.parent / folder).rglob("*.py")):
            tree = ast.parse(path.read_text("utf-8"))
            own, imported = {n for n in inner if path in inner[n]}, imported_by(tree) & set(inner)
            if own or imported:
                assert not (own | imported) & set(used_by_python(tree)), path


def imported_by(tree: ast.Module) -> set[str]:
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {a.name for node in imports if "kernels" in (node.module or "") for a in node.names}


def used_by_python(node: ast.AST) -> Iterator[str]:
    """Names that anything but a kernel's body uses."""
    if isinstance(node, ast.Name):
        yield node.id
    decorators = node.decorator_list if isinstance(node, ast.FunctionDef) else []
    if not any("jit" in ast.unparse(decorator) for decorator in decorators):
        for child in ast.iter_child_nodes(node):
            yield from used_by_python(child)

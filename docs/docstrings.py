"""Which docstrings lack shapes or errors: `python docs/docstrings.py`.

A public function, method or field with arrays gives a shape such as (N, 3); a public function
that raises one of the project's errors names it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
PACKAGES = ("mapmyworld", "formats", "cli")
_SIZE = r"(?:\.\.\.|(?:\d or )?\d+|(?:\d ?)?(?:[A-Z]\w?|[dkmn])(?: ?[-+*] ?\w)?)"
SHAPE = re.compile(rf"\((?:\.\.\.|{_SIZE},(?: {_SIZE},?)*)\)")
Function = ast.FunctionDef | ast.AsyncFunctionDef


class Entry(NamedTuple):
    """One public name, and what its docstring owes."""

    path: str
    line: int
    name: str
    text: str
    arrays: bool
    errors: frozenset[str]

    @property
    def lacks_shape(self) -> bool:
        return self.arrays and not SHAPE.search(" ".join(self.text.split()))

    @property
    def lacks_errors(self) -> bool:
        return any(error not in self.text for error in self.errors)


def entries() -> list[Entry]:
    """Every public name that owes a shape or an error, by file and line."""
    paths = [p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))]
    trees = {str(p.relative_to(ROOT)): ast.parse(p.read_text(encoding="utf-8")) for p in paths}
    errors = {n.name for n in trees["mapmyworld/errors.py"].body if isinstance(n, ast.ClassDef)}
    arrays = {"NDArray", "ArrayLike"} | {a for tree in trees.values() for a in _aliases(tree)}
    found = [
        Entry(path, node.lineno, name, text, bool(arrays & types), frozenset(errors & raised))
        for path, tree in trees.items()
        for node, name, text, types, raised in _public(tree.body, "", "")
    ]
    return [entry for entry in found if entry.arrays or entry.errors]


def _aliases(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        if isinstance(node, ast.Assign) and "NDArray" in _names(node.value):
            yield from (t.id for t in node.targets if isinstance(t, ast.Name))


def _public(
    body: list[ast.stmt], owner: str, text: str
) -> Iterator[tuple[ast.stmt, str, str, set[str], set[str]]]:
    """Node, name, text, names in annotations, and errors raised, of what has no underscore."""
    for node, following in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _public(node.body, f"{node.name}.", ast.get_docstring(node) or "")
        elif isinstance(node, Function) and (node.name == "__init__" or node.name[0] != "_"):
            own = (ast.get_docstring(node) or "") + (text if node.name == "__init__" else "")
            yield node, owner + node.name, own, _annotated(node), _raised(node)
        elif owner and isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            if not node.target.id.startswith("_"):
                own = f"{_literal(following)} {text}"
                yield node, owner + node.target.id, own, _names(node.annotation), set()


def _annotated(function: Function) -> set[str]:
    a = function.args
    given = [*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg]
    types = [x.annotation for x in given if x and x.annotation]
    return {n for t in [*types, function.returns] if t for n in _names(t)}


def _names(node: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


def _raised(function: Function) -> set[str]:
    raised = (n.exc for n in ast.walk(function) if isinstance(n, ast.Raise) and n.exc)
    return {n for exc in raised for n in _names(exc.func if isinstance(exc, ast.Call) else exc)}


def _literal(node: ast.stmt | None) -> str:
    """What a string that stands alone after a field says."""
    value = node.value if isinstance(node, ast.Expr) else None
    return str(value.value) if isinstance(value, ast.Constant) else ""


def package_of(entry: Entry) -> str:
    """`mapmyworld/geometry`, or `formats` and `cli` as a whole."""
    parts = entry.path.split("/")
    return "/".join(parts[:2]) if parts[0] == "mapmyworld" and len(parts) > 2 else parts[0]


if __name__ == "__main__":
    found = entries()
    for lacking, owed, word in (
        ([e for e in found if e.lacks_shape], [e for e in found if e.arrays], "shapes"),
        ([e for e in found if e.lacks_errors], [e for e in found if e.errors], "errors"),
    ):
        for entry in lacking:
            print(f"{entry.path}:{entry.line}: {entry.name} lacks {word}")
        print(f"{word}: {1 - len(lacking) / len(owed):.1%} of {len(owed)} names give them")

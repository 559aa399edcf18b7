"""Which docstrings lack shapes or errors: `python docs/docstrings.py`.

A public function, method or field with arrays gives a shape such as (N, 3); a public function
that raises one of the project's errors names it. A method of a protocol's is documented there,
and the text of a command is its help.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
PACKAGES = ("mapmyworld", "formats", "cli")
_SIZE = r"(?:\.\.\.|(?:\d or )?\d+|(?:\d ?)?(?:[A-Z]\w*|[dkmn])(?: ?[-+*] ?\w+)?)"
SHAPE = re.compile(rf"\((?:\.\.\.|{_SIZE},(?: {_SIZE},?)*)\)")
Function = ast.FunctionDef | ast.AsyncFunctionDef


class Entry(NamedTuple):
    """One public name, its docstring, and what that owes: a shape, errors."""

    place: str
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
    trees = {p.relative_to(ROOT): ast.parse(p.read_text(encoding="utf-8")) for p in paths}
    errors = {c.name for c in _classes(trees[Path("mapmyworld/errors.py")])}
    protocols = [c for t in trees.values() for c in _classes(t) if "Protocol" in _names(*c.bases)]
    inherited = {n: t for c in protocols for _, n, t, *_ in _public(c.body, ".", "", {}) if t}
    arrays: dict[str, set[str]] = {}  # of every module: names that mean arrays
    while arrays != (arrays := {_module(p): _aliases(t, arrays) for p, t in trees.items()}):
        pass
    found = [
        Entry(f"{path}:{node.lineno}", name, text, bool(arrays[_module(path)] & types),
              frozenset(errors & raised))
        for path, tree in trees.items()
        for node, name, text, types, raised in _public(tree.body, "", "", inherited)
    ]  # fmt: skip
    return [entry for entry in found if entry.arrays or entry.errors]


def _module(path: Path) -> str:
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


def _aliases(tree: ast.Module, arrays: dict[str, set[str]]) -> set[str]:
    found = {"NDArray", "ArrayLike"}
    for node in tree.body:
        if isinstance(node, ast.Assign) and found & _names(node.value):
            found |= {t.id for t in node.targets if isinstance(t, ast.Name)}
        elif isinstance(node, ast.ImportFrom):
            found |= {a.name for a in node.names if a.name in arrays.get(node.module or "", ())}
    return found


def _classes(tree: ast.Module) -> list[ast.ClassDef]:
    return [node for node in tree.body if isinstance(node, ast.ClassDef)]


def _public(
    body: list[ast.stmt], owner: str, text: str, inherited: dict[str, str]
) -> Iterator[tuple[ast.stmt, str, str, set[str], set[str]]]:
    """Node, name, text, names in annotations, and errors raised, of what has no underscore."""
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and node.name[0] != "_":
            inner = f"{owner}{node.name}.", ast.get_docstring(node) or "", inherited
            yield from _public(node.body, *inner)
        elif isinstance(node, Function) and (node.name == "__init__" or node.name[0] != "_"):
            own = ast.get_docstring(node) or (inherited.get(f".{node.name}", "") if owner else "")
            own += text if node.name == "__init__" else ""
            a = node.args
            given = [*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg]
            types = _names(*(x.annotation for x in given if x), node.returns)
            if not any("command" in ast.unparse(d) for d in node.decorator_list):
                yield node, owner + node.name, own, types, _raised(node)
        elif owner and isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            field = ast.unparse(after) if isinstance(after, ast.Expr) else ""
            if node.target.id[0] != "_":
                own, types = f"{field} {text}", _names(node.annotation)
                yield node, owner + node.target.id, own, types, set()


def _names(*nodes: ast.AST | None) -> set[str]:
    return {n.id for node in nodes if node for n in ast.walk(node) if isinstance(n, ast.Name)}


def _raised(function: Function) -> set[str]:
    raised = (n.exc for n in ast.walk(function) if isinstance(n, ast.Raise))
    return {n for exc in raised for n in _names(exc.func if isinstance(exc, ast.Call) else exc)}


def report() -> Iterator[str]:
    """A line for each name that lacks something, then the shares of those that do not."""
    found = entries()
    shapes, errors = [e for e in found if e.arrays], [e for e in found if e.errors]
    for owed, lacking, word in (
        (shapes, [e for e in shapes if e.lacks_shape], "shape"),
        (errors, [e for e in errors if e.lacks_errors], "error"),
    ):
        yield from (f"{entry.place}: {entry.name} gives no {word}" for entry in lacking)
        yield f"{1 - len(lacking) / len(owed):.1%} of {len(owed)} names give their {word}s"


if __name__ == "__main__":
    sys.stdout.writelines(f"{line}\n" for line in report())

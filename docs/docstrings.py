"""Which docstrings lack shapes or errors: `python docs/docstrings.py`.

A public function, method or field with arrays gives a shape such as (N, 3); one that raises an
error of the project's names it. Protocols document their methods; a command's text is its help.
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
_SIZE = r"(?:\.\.\.|(?:\d or )?\d+|(?:\d ?)?(?:[A-Z]+\d?|[dkmn])(?: ?[-+*] ?\w+)?)"
SHAPE = re.compile(rf"\((?:\.\.\.|{_SIZE},(?: {_SIZE},?)*)\)")


class Entry(NamedTuple):
    """One public name, its docstring, and what that owes: a shape, errors."""

    place: str
    name: str
    text: str
    arrays: bool
    errors: frozenset[str]

    def lacks_shape(self) -> bool:
        return not SHAPE.search(" ".join(self.text.split()))

    def lacks_error(self) -> bool:
        return any(error not in self.text for error in self.errors)


def entries() -> list[Entry]:
    """Every public function and field, by file and line."""
    paths = [p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))]
    trees = {p.relative_to(ROOT): ast.parse(p.read_text(encoding="utf-8")) for p in paths}
    errors = {c.name for c in _classes(trees[Path("mapmyworld/errors.py")])}
    protocols = [c for t in trees.values() for c in _classes(t) if "Protocol" in _names(*c.bases)]
    above = {n: t for c in protocols for _, n, t, *_ in _public(c.body, ".", "", {}) if t}
    arrays: dict[str, set[str]] = {}  # of every module: names that mean arrays
    while arrays != (arrays := {_module(p): _aliases(t, arrays) for p, t in trees.items()}):
        pass
    return [
        Entry(f"{path}:{node.lineno}", name, text, bool(arrays[_module(path)] & types),
              frozenset(errors & raised))
        for path, tree in trees.items()
        for node, name, text, types, raised in _public(tree.body, "", "", above)
    ]  # fmt: skip


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
    body: list[ast.stmt], owner: str, text: str, above: dict[str, str]
) -> Iterator[tuple[ast.stmt, str, str, set[str], set[str]]]:
    """Node, name, text, names in annotations, and errors raised, of what has no underscore."""
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and node.name[0] != "_":
            yield from _public(
                node.body, f"{owner}{node.name}.", ast.get_docstring(node) or "", above
            )
        elif isinstance(node, ast.FunctionDef) and re.match("__init__|[^_]", node.name):
            own = ast.get_docstring(node) or (above.get(f".{node.name}", "") if owner else "")
            own += text if node.name == "__init__" else ""
            given = (a.annotation for a in ast.walk(node.args) if isinstance(a, ast.arg))
            types = _names(node.returns, *given)
            if not any("command" in ast.unparse(d) for d in node.decorator_list):
                yield node, owner + node.name, own, types, _raised(node)
        elif owner and isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            field = ast.unparse(after) if isinstance(after, ast.Expr) else ""
            if node.target.id[0] != "_":
                own, types = f"{field} {text}", _names(node.annotation)
                yield node, owner + node.target.id, own, types, set()


def _names(*nodes: ast.AST | None) -> set[str]:
    return {n.id for node in nodes if node for n in ast.walk(node) if isinstance(n, ast.Name)}


def _raised(function: ast.FunctionDef) -> set[str]:
    raised = (n.exc for n in ast.walk(function) if isinstance(n, ast.Raise))
    return {n for exc in raised for n in _names(exc.func if isinstance(exc, ast.Call) else exc)}


def report() -> Iterator[str]:
    """A line for each name that lacks something, then the shares of those that do not."""
    found = entries()
    for word, owed, lacks in (
        ("shape", [e for e in found if e.arrays], Entry.lacks_shape),
        ("error", [e for e in found if e.errors], Entry.lacks_error),
    ):
        lacking = [entry for entry in owed if lacks(entry)]
        yield from (f"{entry.place}: {entry.name} gives no {word}" for entry in lacking)
        yield f"{1 - len(lacking) / len(owed):.1%} of {len(owed)} names give their {word}s"


if __name__ == "__main__":
    sys.stdout.writelines(f"{line}\n" for line in report())

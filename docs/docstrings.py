"""Which docstrings lack shapes or errors: `python docs/docstrings.py`.

A public function, method or field gives a shape such as (N, 3) for each of its arrays, those of its
result included; one that raises an error of the project's names it. Protocols document their
methods; a command's text is its help.

Shapes are counted: one stands for as many arrays as are named before it (`a` and `b` (N,)), for two
with "both" beside it ("two poses (3,)" as well), for all with "each"; "the same shape" is one more.
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
_SIZE = r"(?:\.\.\.|(?:\d or )?\d+|(?:\d ?)?(?:[A-Z]+\d?|[dkmnr])(?: ?[-+*] ?\w+)?)"
_LIST = r"((?:`\w+`(?:,| and|, and)? )*)"
_SHAPE = rf"\((?:\.\.\.|{_SIZE},(?: {_SIZE},?)*)\)"
SHAPE = re.compile(rf"{_LIST}(both |each |two \w+ )?{_SHAPE}( both| each)?")


class Entry(NamedTuple):
    """One public name, its docstring, and what that owes: shapes of its arrays, errors."""

    place: str
    name: str
    text: str
    arrays: list[str]
    errors: frozenset[str]

    def unshaped(self) -> list[str]:
        """The arrays, where there are fewer shapes."""
        text = " ".join(self.text.split())
        given = text.count("same shape")
        for names, before, after in SHAPE.findall(text):
            words = f"{before}{after}"
            least = 2 if "both" in words or "two" in words else 1
            given += len(self.arrays) if "each" in words else max(names.count("`") // 2, least)
        return self.arrays if given < len(self.arrays) else []

    def unnamed(self) -> list[str]:
        """The errors that are not named."""
        return sorted(error for error in self.errors if error not in self.text)


def entries() -> list[Entry]:
    """Every public function and field, by file and line."""
    paths = [p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))]
    trees = {p.relative_to(ROOT): ast.parse(p.read_text(encoding="utf-8")) for p in paths}
    errors = {c.name for c in _classes(trees[Path("mapmyworld/errors.py")])}
    classes = [c for tree in trees.values() for c in _classes(tree)]
    protocols = [c for c in classes if "Protocol" in map(ast.unparse, c.bases)]
    above = {n: t for c in protocols for _, n, t, *_ in _public(c.body, ".", "", {}) if t}
    arrays: dict[str, set[str]] = {}  # of every module: names that mean arrays
    while arrays != (arrays := {_module(p): _aliases(t, arrays) for p, t in trees.items()}):
        pass
    return [
        Entry(f"{path}:{node.lineno}", name, text, _arrays(given, arrays[_module(path)]),
              frozenset(errors.intersection(raised)))
        for path, tree in trees.items()
        for node, name, text, given, raised in _public(tree.body, "", "", above)
    ]  # fmt: skip


def _arrays(annotations: dict[str, ast.expr | None], arrays: set[str]) -> list[str]:
    """The parameters with arrays, and `result` once for each array of it."""
    found = []
    for name, annotation in annotations.items():
        count = sum(word in arrays for word in _names(annotation))
        found += [name] * (count if name == "result" else min(count, 1))
    return found


def _module(path: Path) -> str:
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


def _aliases(tree: ast.Module, arrays: dict[str, set[str]]) -> set[str]:
    found = {"NDArray", "ArrayLike", "ndarray"}
    for node in tree.body:
        if isinstance(node, ast.Assign) and found.intersection(_names(node.value)):
            found |= {t.id for t in node.targets if isinstance(t, ast.Name)}
        elif isinstance(node, ast.ImportFrom):
            found |= {a.name for a in node.names if a.name in arrays.get(node.module or "", ())}
    return found


def _classes(tree: ast.Module) -> list[ast.ClassDef]:
    return [node for node in tree.body if isinstance(node, ast.ClassDef)]


def _public(
    body: list[ast.stmt], owner: str, text: str, above: dict[str, str]
) -> Iterator[tuple[ast.stmt, str, str, dict[str, ast.expr | None], list[str]]]:
    """Node, name, text, annotations, and errors raised, of what has no underscore."""
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and node.name[0] != "_":
            yield from _public(
                node.body, f"{owner}{node.name}.", ast.get_docstring(node) or "", above
            )
        elif isinstance(node, ast.FunctionDef) and re.match("__init__|[^_]", node.name):
            own = ast.get_docstring(node) or (above.get(f".{node.name}", "") if owner else "")
            own += f" {text}" if node.name == "__init__" else ""
            given = {a.arg: a.annotation for a in ast.walk(node.args) if isinstance(a, ast.arg)}
            given["result"] = node.returns
            if not any("command" in ast.unparse(d) for d in node.decorator_list):
                yield node, owner + node.name, own, given, _raised(node)
        elif owner and isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            field = ast.unparse(after) if isinstance(after, ast.Expr) else ""
            if node.target.id[0] != "_":
                given = {node.target.id: node.annotation}
                yield node, owner + node.target.id, f"{field} {text}", given, []


def _names(node: ast.AST | None) -> list[str]:
    """Names and attributes in an expression, once for each time that they stand there."""
    parts = ast.walk(node) if node else ()
    names = (getattr(part, "id", getattr(part, "attr", None)) for part in parts)
    return [name for name in names if name]


def _raised(function: ast.FunctionDef) -> list[str]:
    raised = (n.exc for n in ast.walk(function) if isinstance(n, ast.Raise))
    return [n for exc in raised for n in _names(exc.func if isinstance(exc, ast.Call) else exc)]


def report() -> Iterator[str]:
    """A line for each name that lacks something, then the shares of those that do not."""
    found = entries()
    for word, owed, lacking in (
        ("shape", [e for e in found if e.arrays], Entry.unshaped),
        ("error", [e for e in found if e.errors], Entry.unnamed),
    ):
        short = [(entry, names) for entry in owed if (names := lacking(entry))]
        for entry, names in short:
            yield f"{entry.place}: {entry.name} gives too few {word}s for {', '.join(names)}"
        yield f"{1 - len(short) / len(owed):.1%} of {len(owed)} names give all their {word}s"


if __name__ == "__main__":
    sys.stdout.writelines(f"{line}\n" for line in report())

"""The library as a notebook uses it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from room_drive import drive

import formats
import mapmyworld


def names_in(stub: str) -> set[str]:
    """What a stub file promises."""
    found: set[str] = set()
    for node in ast.parse((ROOT / stub).read_text()).body:
        if isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found.add(node.target.id)
    return found


@pytest.mark.parametrize("module", [mapmyworld, formats])
def test_what_is_promised_is_there(module: object) -> None:
    name = module.__name__  # type: ignore[attr-defined]
    assert set(module.__all__) == names_in(f"{name}/__init__.pyi")  # type: ignore[attr-defined]
    for attribute in module.__all__:  # type: ignore[attr-defined]
        assert getattr(module, attribute) is not None
    with pytest.raises(AttributeError, match="nothing_of_ours"):
        _ = module.nothing_of_ours  # type: ignore[attr-defined]


def test_importing_the_library_loads_nothing() -> None:
    code = "import mapmyworld, formats, sys; print('numpy' in sys.modules)"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300
    )
    assert out.stdout.strip() == "False"


def test_a_map_in_memory_is_that_of_a_file(tmp_path: Path) -> None:
    log = mapmyworld.MemoryLog(drive().entries)
    memory = mapmyworld.build(log)
    with formats.open_map(tmp_path / "map.db", create=True) as store:
        filed = mapmyworld.build(log, into=store)
        assert filed.result.nodes == memory.result.nodes
        ours, theirs = memory.map.poses(), store.poses()
        assert ours is not None
        assert theirs is not None
        np.testing.assert_allclose(ours.map_from_node, theirs.map_from_node, atol=1e-6)


def test_settings_are_checked() -> None:
    assert mapmyworld.configured(mapping__resolution=0.1).mapping.resolution == 0.1
    with pytest.raises(mapmyworld.MapMyWorldError, match="resolution"):
        mapmyworld.configured(mapping__resolutoin=0.1)

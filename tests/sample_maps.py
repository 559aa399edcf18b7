"""Maps of the sample logs, built once for all tests that look at finished maps."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import ROOT

from cli.main import group

APARTMENT = ROOT / "sample_logs" / "apartment.mcap"


@pytest.fixture(scope="session")
def apartment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`map.db` of the apartment with all that `build` writes beside it; not to be changed."""
    path = tmp_path_factory.mktemp("apartment") / "map.db"
    result = CliRunner().invoke(group, ["build", str(APARTMENT), "-o", str(path), "-q"])
    assert result.exit_code == 0, result.output
    return path

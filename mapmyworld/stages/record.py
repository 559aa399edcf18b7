"""Which stages are done, and with which inputs: a chain of hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Any

import mapmyworld
from mapmyworld.decisions import decided
from mapmyworld.types import MapStore


class StageRecord:
    """Runs stages, and passes over those that the store holds already with the same inputs.

    A stage's inputs are the stage before it (down to the log's bytes), the version, and what it is
    the first one to read of settings and statements.
    """

    def __init__(self, store: MapStore, log_hash: str) -> None:
        self._store = store
        self._chain = _digest(mapmyworld.__version__, log_hash)
        self.reused: list[str] = []
        """Stages that were found done."""

    def run(self, stage: str, inputs: tuple[Any, ...], work: Callable[[], None]) -> None:
        """Does the work of a stage unless it is done; `inputs` are values of JSON."""
        self._chain = _digest(self._chain, stage, *inputs)
        if self._store.stage_done(stage, self._chain):
            self.reused.append(stage)
            decided("stage", f"{stage}: done before with the same inputs")
            return
        decided("stage", f"{stage}: inputs {self._chain[:12]}, not done before")
        with self._store.write_stage(stage, self._chain):
            work()

    def again(self, stage: str, work: Callable[[], None]) -> None:
        """Does the stage that was run last once more, from its beginning: it taught better."""
        decided("stage", f"{stage}: once more, with what it measured")
        with self._store.write_stage(stage, self._chain):
            work()


def _digest(*parts: Any) -> str:
    text = json.dumps(parts, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()

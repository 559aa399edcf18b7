"""Scans made ready for matching, of which only those that are in use are held in memory.

After hours of driving they would be most of what a build holds, and they are soon made again.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict
from threading import Lock
from typing import Protocol

import numpy as np

from mapmyworld.config import RegistrationConfig
from mapmyworld.geometry import Index
from mapmyworld.parallel import batches
from mapmyworld.registration.scan_matching import ScanSet, prepare_scans, scan_set
from mapmyworld.types import MapStore

BLOCK = 256
"""Scans that are made ready together."""
_HELD = 32  # blocks that are held, about an hour of driving


class Scans(Protocol):
    """Scans by number, made ready."""

    def some(self, which: Index) -> ScanSet:
        """Scans `which` (K,), in this order."""

    def let_go(self) -> None:
        """Gives memory back: for a while nobody will ask."""


class StoredScans:
    """The scans of a store, block by block; any thread may ask."""

    def __init__(self, store: MapStore, frames: Index, config: RegistrationConfig) -> None:
        """Those of `frames` (N,), as far as they have one."""
        self._store, self._config = store, config
        self._blocks: OrderedDict[int, ScanSet] = OrderedDict()
        self._reading = Lock()
        found: list[int] = []
        sizes = [np.zeros(0, np.int64)]
        for number, some in enumerate(batches(store.scans(frames), BLOCK)):
            found += [frame for frame, _ in some]
            made = prepare_scans([scan for _, scan in some], config)
            sizes.append(np.diff(made.bounds))
            self._keep(number, made)
        self.frames = np.array(found, np.int64)
        """(S,) of each scan."""
        self.sizes = np.concatenate(sizes)
        """(S,) points of each scan."""

    def __len__(self) -> int:
        return len(self.frames)

    def some(self, which: Index) -> ScanSet:
        """Scans `which` (K,), in this order: a copy, for which only a block at a time is held."""
        bounds = np.concatenate([[0], np.cumsum(self.sizes[which])]).astype(np.int64)
        rows = np.empty((bounds[-1], 6), np.float32)
        origins = np.empty((len(which), 2))
        starts = np.flatnonzero(np.diff(which // BLOCK, prepend=-1))
        for first, end in itertools.pairwise([*starts.tolist(), len(which)]):
            block = self._block(int(which[first]) // BLOCK)
            some = scan_set([block.one(k % BLOCK) for k in which[first:end].tolist()])
            rows[bounds[first] : bounds[end]], origins[first:end] = some.rows, some.origins
        return ScanSet(rows, bounds, origins)

    def let_go(self) -> None:
        """Holds none."""
        self._blocks.clear()

    def _block(self, number: int) -> ScanSet:
        with self._reading:
            found = self._blocks.get(number)
            if found is None:
                frames = self.frames[number * BLOCK : (number + 1) * BLOCK]
                found = prepare_scans([s for _, s in self._store.scans(frames)], self._config)
                self._keep(number, found)
            self._blocks.move_to_end(number)
            return found

    def _keep(self, number: int, scans: ScanSet) -> None:
        self._blocks[number] = scans
        if len(self._blocks) > _HELD:
            self._blocks.popitem(last=False)

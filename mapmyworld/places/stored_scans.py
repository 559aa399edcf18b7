"""Scans made ready for matching, of which only those that are in use are held in memory.

After hours of driving they would be most of what a build holds, and they are soon made again.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import RegistrationConfig
from mapmyworld.parallel import batches
from mapmyworld.registration.scan_matching import ScanSet, prepare_scans, scan_set
from mapmyworld.types import MapStore

Index = NDArray[np.int64]
BLOCK = 256
"""Scans that are made ready together."""
_HELD = 32  # blocks that are held, about an hour of driving


class Scans(Protocol):
    """Scans by number, made ready."""

    def some(self, which: Index) -> ScanSet:
        """Scans `which` (K,), in this order."""

    def hold(self, which: Index) -> Scans:
        """At least scans `which` (K,), under the same numbers, for other threads to read."""

    def let_go(self) -> None:
        """Gives memory back: for a while nobody will ask."""


class StoredScans:
    """The scans of a store, block by block; for one thread."""

    def __init__(self, store: MapStore, frames: Index, config: RegistrationConfig) -> None:
        """Those of `frames` (N,), as far as they have one."""
        self._store, self._config = store, config
        self._blocks: OrderedDict[int, ScanSet] = OrderedDict()
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
        rows = np.empty((bounds[-1], 5), np.float32)
        origins = np.empty((len(which), 2))
        edges = np.flatnonzero(np.diff(which // BLOCK)) + 1
        for first, end in itertools.pairwise([0, *edges.tolist(), len(which)]):
            some = self.hold(which[first:end]).some(which[first:end])
            rows[bounds[first] : bounds[end]], origins[first:end] = some.rows, some.origins
        return ScanSet(rows, bounds, origins)

    def hold(self, which: Index) -> HeldScans:
        """At least scans `which` (K,); they stay in memory as long as the result."""
        return HeldScans({k: self._block(k) for k in np.unique(which // BLOCK).tolist()})

    def let_go(self) -> None:
        """Holds none."""
        self._blocks.clear()

    def _block(self, number: int) -> ScanSet:
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


@dataclass(frozen=True, slots=True, eq=False)
class HeldScans:
    """Some blocks of stored scans, which any thread may read."""

    blocks: Mapping[int, ScanSet]

    def some(self, which: Index) -> ScanSet:
        """Scans `which` (K,), in this order."""
        return scan_set([self.blocks[k // BLOCK].one(k % BLOCK) for k in which.tolist()])

    def hold(self, which: Index) -> HeldScans:
        """Scans `which` (K,) are held already."""
        return self

    def let_go(self) -> None:
        """They stay."""

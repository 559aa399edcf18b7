"""The next block read on another thread, while messages of the one before are used."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise

from formats.logs.channels import Block, Record

_SMALL_BYTES = 1 << 24  # of a block's payloads: beside larger ones no other is held


@contextmanager
def read_ahead(
    read: Callable[[Block], list[Record]], order: Sequence[Block]
) -> Iterator[Callable[[Block], list[Record]]]:
    """Gives a `read` that begins with the next block in `order` when it hands one out.

    Reading and decompressing need no interpreter, so that another core does them. All is read on
    one thread, for there is one stream.
    """
    following = {block.offset: after for block, after in pairwise(order)}
    begun: dict[int, Future[list[Record]]] = {}
    with ThreadPoolExecutor(1) as reader:

        def take(block: Block) -> list[Record]:
            found = begun.pop(block.offset, None) or reader.submit(read, block)
            records = found.result()
            after = following.pop(block.offset, None)
            if after is not None and sum(len(record[2]) for record in records) <= _SMALL_BYTES:
                begun[after.offset] = reader.submit(read, after)
            return records

        yield take

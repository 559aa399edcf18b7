"""Work ahead on other threads: the same items, in order, with their errors in place."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from mapmyworld.parallel import batches, in_threads, made_ahead


def counting(to: int, fail_at: int = -1) -> Iterator[int]:
    for i in range(to):
        if i == fail_at:
            raise ValueError("no more")
        yield i


@pytest.mark.parametrize("ahead", [1, 3, 100])
def test_items_come_in_order(ahead: int) -> None:
    assert list(made_ahead(counting(50), ahead)) == list(range(50))


def test_an_error_comes_where_its_item_would_have_come() -> None:
    seen = []
    with pytest.raises(ValueError, match="no more"):
        seen.extend(made_ahead(counting(50, fail_at=7), 3))
    reader = made_ahead(counting(50, fail_at=2), 3)
    assert [next(reader), next(reader)] == [0, 1]
    with pytest.raises(ValueError, match="no more"):
        next(reader)


def test_nobody_is_left_behind_when_reading_stops_early() -> None:
    before = threading.active_count()
    reader = made_ahead(counting(10_000), 2)
    assert next(reader) == 0
    reader.close()
    assert threading.active_count() == before


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_work_of_many_threads_comes_in_order(threads: int) -> None:
    assert list(in_threads(lambda i: i * i, range(40), threads)) == [i * i for i in range(40)]


def test_an_error_of_work_comes_where_its_result_would_have_come() -> None:
    def work(item: int) -> int:
        if item == 7:
            raise ValueError("seven")
        return item

    results = in_threads(work, range(50), 2)
    assert [next(results) for _ in range(7)] == list(range(7))
    with pytest.raises(ValueError, match="seven"):
        next(results)


def test_batches_hold_every_item_once() -> None:
    assert list(batches(range(7), 3)) == [[0, 1, 2], [3, 4, 5], [6]]
    assert list(batches([], 3)) == []

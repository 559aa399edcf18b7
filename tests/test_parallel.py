"""Work ahead on other threads: the same items, in order, with their errors in place."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from mapmyworld.parallel import batches, done_behind, in_threads, made_ahead


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


def test_work_behind_is_done_in_order() -> None:
    done: list[int] = []
    with done_behind(done.append, 2) as hand_over:
        for item in range(50):
            hand_over(item)
    assert done == list(range(50))


def test_an_error_of_work_behind_reaches_who_hands_over() -> None:
    done: list[int] = []

    def work(item: int) -> None:
        if item == 7:
            raise ValueError("seven")
        done.append(item)

    def hand_all_over() -> None:
        with done_behind(work, 2) as hand_over:
            for item in range(50):
                hand_over(item)

    with pytest.raises(ValueError, match="seven"):
        hand_all_over()
    assert done == list(range(7))


def test_batches_hold_every_item_once() -> None:
    assert list(batches(range(7), 3)) == [[0, 1, 2], [3, 4, 5], [6]]
    assert list(batches([], 3)) == []

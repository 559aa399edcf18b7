"""Logs and maps addressed by URLs: fetched, delivered, seen to change, refused clearly."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from cli.batching.job import Result, failure, finished
from cli.batching.manifest import Job
from cli.batching.urls import delivered, fetched, is_url, mark_of, read_text
from mapmyworld.errors import LogError, MapError, MissingDependencyError


class Bucket(MemoryFileSystem):
    """An object store: keys and bytes, and a door that may be shut."""

    protocol = "bucket"
    store: dict[str, object] = {}  # noqa: RUF012 - as fsspec has it
    pseudo_dirs: list[str] = [""]  # noqa: RUF012
    shut = False

    def pipe_file(self, path: str, value: bytes, *rest: object, **options: object) -> None:
        if self.shut:
            raise PermissionError("403: the bucket is closed")
        super().pipe_file(path, value, *rest, **options)

    def put_file(self, lpath: str, rpath: str, **options: object) -> None:
        self.pipe_file(rpath, Path(lpath).read_bytes())


fsspec.register_implementation("bucket", Bucket, clobber=True)


@pytest.fixture(params=["bucket://week", "memory://week", "file"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """The URL of a folder, in stores of three kinds."""
    yield f"file://{tmp_path}/week" if request.param == "file" else request.param
    for kind in (Bucket, MemoryFileSystem):
        kind.store.clear()


@pytest.mark.parametrize(
    ("text", "expected"),
    [("s3://a/b", True), ("file:///a", True), ("/a/b", False), ("a://", True), ("C:/a", False)],
)
def test_what_is_a_url(text: str, expected: bool) -> None:
    assert is_url(text) is expected


def test_what_is_delivered_can_be_fetched_and_read(place: str, tmp_path: Path) -> None:
    made, back = tmp_path / "map.db", tmp_path / "back"
    made.write_bytes(bytes(range(256)) * 40)
    back.mkdir()
    delivered([made], f"{place}/monday")
    assert fetched(f"{place}/monday/map.db", back).read_bytes() == made.read_bytes()
    whole = fetched(f"{place}/monday", back)  # as a rosbag2 folder is a log
    assert (whole / "map.db").read_bytes() == made.read_bytes()
    assert read_text(f"{place}/monday/none.json") is None


def test_a_changed_log_is_noticed(place: str, tmp_path: Path) -> None:
    log = tmp_path / "log.bag"
    log.write_bytes(b"first")
    delivered([log], place)
    before = mark_of(f"{place}/log.bag")
    assert mark_of(f"{place}/log.bag") == before
    log.write_bytes(b"second and longer")
    delivered([log], place)
    assert mark_of(f"{place}/log.bag") != before
    assert mark_of(f"{place}/none.bag") == "absent"


def test_what_is_not_there_is_named(place: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"none\.bag: cannot be fetched"):
        fetched(f"{place}/none.bag", tmp_path)


def test_a_store_that_refuses_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "map.db").write_bytes(b"map")
    monkeypatch.setattr(Bucket, "shut", True)
    with pytest.raises(MapError, match=r"bucket://week: cannot be written: .*closed"):
        delivered([tmp_path / "map.db"], "bucket://week")


def test_without_fsspec_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'mapmyworld\[distributed\]'"):
        fetched("s3://robots/log.bag", tmp_path)


def test_an_unknown_kind_of_store_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MissingDependencyError, match="carrier-pigeon://log"):
        fetched("carrier-pigeon://log", tmp_path)


def test_a_failure_is_tried_again_and_a_map_is_not(place: str, tmp_path: Path) -> None:
    import json
    from dataclasses import asdict

    from cli.batching.job import _key

    job = Job("monday", (f"{place}/log.bag",))
    note = tmp_path / "result.json"
    built = Result("monday", "built", "", {"nodes": 3}, [], {"map.db": "00"})
    for result, expected in ((built, built), (failure(job, "no such file"), None)):
        note.write_text(json.dumps({"key": _key(job), "result": asdict(result)}))
        delivered([note], f"{place}/monday")
        assert finished(job, place) == expected
    note.write_text("{ torn")
    delivered([note], f"{place}/monday")
    assert finished(job, place) is None

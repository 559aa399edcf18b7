"""One log of a batch: built, checked and noted, in processes of its own."""

from __future__ import annotations

import hashlib
import json
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import mapmyworld
from cli.batching.commands import run_command, why
from cli.batching.manifest import Job
from cli.batching.urls import delivered, fetched, is_url, mark_of, read_text
from cli.exit_codes import EXIT_BAD_INPUT
from cli.repeating import REPEATED
from formats.whole_files import write_whole
from mapmyworld.errors import MapMyWorldError

Status = Literal["built", "partial", "failed"]
_NOTE = "result.json"
_KEPT = ("nodes", "frames", "distance_m", "duration_s", "constraints", "losses")


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a job; nothing in it depends on when, where or how often it ran."""

    name: str
    status: Status
    message: str
    """Why it failed; empty otherwise."""
    figures: dict[str, Any]
    """Nodes, frames, length, constraints, losses."""
    checks: list[dict[str, Any]]
    """Requirement, value and whether it holds."""
    files: dict[str, str]
    """File -> SHA-256."""

    @property
    def passed(self) -> bool:
        """Whether every requirement was met."""
        return all(check["passed"] for check in self.checks)


def finished(job: Job, output: str) -> Result | None:
    """The noted map of an earlier run, where it was of this very job; failures are tried again."""
    text = read_text(f"{output}/{job.name}/{_NOTE}")
    try:
        note = json.loads(text) if text else {}
        known = Result(**note["result"]) if note.get("key") == _key(job) else None
    except (ValueError, TypeError, KeyError):
        return None
    return None if known is None or known.status == "failed" else known


def run_job(job: Job, output: str, threads: int) -> Result:
    """The job's result, noted in its folder under `output`."""
    try:
        with tempfile.TemporaryDirectory(prefix="mapmyworld-batch-") as scratch:
            folder = Path(scratch) / "map" if is_url(output) else Path(output) / job.name
            folder.mkdir(parents=True, exist_ok=True)
            result = _result(job, folder, Path(scratch), threads)
            note = {"key": _key(job), "result": asdict(result)}
            write_whole(folder / _NOTE, json.dumps(note, indent=1) + "\n")
            if is_url(output):
                files = [folder / name for name in (*result.files, _NOTE)]
                delivered(files, f"{output.rstrip('/')}/{job.name}")
    except (MapMyWorldError, OSError) as error:
        return failure(job, str(error))
    return result


def failure(job: Job, why: str) -> Result:
    """The result of a job that gave no map."""
    return Result(job.name, "failed", why, {}, _unmet(job), {})


def _key(job: Job) -> str:
    """Changes when the job, a file it reads, or the program does."""
    places = [*job.logs, *(place for _, place in job.truths)]
    parts = [mapmyworld.__version__, asdict(job), [mark_of(place) for place in places]]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _result(job: Job, folder: Path, scratch: Path, threads: int) -> Result:
    logs = [str(fetched(log, scratch)) for log in job.logs]
    truths = [(option, str(fetched(place, scratch))) for option, place in job.truths]
    _forget_another_job(job, folder)
    done = _build(job, logs, folder, threads)
    if done.returncode == EXIT_BAD_INPUT:
        return failure(job, why(done))
    summary = json.loads(done.stdout)
    checks, problem = _checks(job, folder / "map.db", truths)
    return Result(
        job.name,
        "failed" if problem else "partial" if done.returncode else "built",
        problem,
        {name: summary[name] for name in _KEPT},
        checks,
        {
            file.name: _digest(file)
            for file in map(Path, summary["files"])
            if file.suffix in REPEATED
        },
    )


def _forget_another_job(job: Job, folder: Path) -> None:
    """A folder of this name that was made of something else is made anew."""
    mark = folder / "job.json"
    text = json.dumps([job.logs, [mark_of(log) for log in job.logs]])
    if read_text(str(mark)) != text:
        for name in ("map.db", "map.db-journal", _NOTE):
            (folder / name).unlink(missing_ok=True)
        write_whole(mark, text)


def _build(
    job: Job, logs: Sequence[str], folder: Path, threads: int
) -> subprocess.CompletedProcess[str]:
    settings = job.settings
    if not any(setting.startswith("threads=") for setting in settings):
        settings = (*settings, f"threads={threads}")
    options = [word for setting in settings for word in ("--set", setting)]
    command = ["build", *logs, "-o", str(folder / "map.db"), "--method", job.method, "--quiet"]
    return run_command([*command, "--format", "json", *options])


def _checks(
    job: Job, path: Path, truths: Sequence[tuple[str, str]]
) -> tuple[list[dict[str, Any]], str]:
    """Every requirement with its value, and why it could not be checked."""
    if not job.requirements:
        return [], ""
    options = [word for text in job.requirements for word in ("--require", text)]
    options += [word for option, place in truths for word in (f"--{option}", place)]
    done = run_command(["check", str(path), "--format", "json", *options])
    if done.returncode == EXIT_BAD_INPUT:
        return _unmet(job), why(done)
    return list(json.loads(done.stdout)["requirements"]), ""


def _unmet(job: Job) -> list[dict[str, Any]]:
    return [{"require": text, "value": None, "passed": False} for text in job.requirements]


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

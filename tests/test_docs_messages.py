"""The table of messages: nothing is raised for bad input that does not stand in it."""

from __future__ import annotations

import ast
import re
import sys

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import all_messages as messages

# Raised with words that come from elsewhere: the system's, or those of a message in the table.
PASSED_ON = {
    "cli/batching/commands.py": 1,
    "cli/batching/urls.py": 1,
    "mapmyworld/exporting.py": 1,
    "formats/database/connection.py": 1,
    "formats/database/log_source.py": 1,
    "formats/database/image_blobs.py": 1,
    "formats/graph_reading.py": 1,
    "formats/trajectory_files.py": 1,
    "mapmyworld/evaluation/association.py": 1,
}
_OURS = (
    "LogError", "MapError", "ConfigError", "GraphError", "WorldError", "MissingDependencyError",
    "NotPositiveDefiniteError", "MemoryLimitError", "UsageError", "DamagedBlockError",
)  # fmt: skip


def raised_without_words() -> dict[str, int]:
    found: dict[str, int] = {}
    for room in ("cli", "formats", "mapmyworld"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                    name = ast.unparse(node.exc.func).rpartition(".")[2]
                    words = messages._template(node.exc.args[0]) if node.exc.args else ""
                    if name in _OURS and len(words.replace("...", "").strip(" :,()")) < 5:
                        file = path.relative_to(ROOT).as_posix()
                        found[file] = found.get(file, 0) + 1
    return found


def test_every_error_has_words_that_stand_in_the_table() -> None:
    assert raised_without_words() == PASSED_ON


def test_every_message_says_what_to_do_about_it() -> None:
    reported = messages.gathered()
    assert len(reported) > 300
    assert [entry.text for entry in reported if len(entry.suggestion) < 9] == []


@pytest.mark.parametrize("file", ["formats/logs/new_log.py", "formats/new_files.py"])
def test_a_new_format_gets_no_suggestion_that_is_none_of_its_own(file: str) -> None:
    """What helps with a damaged log is none where one is refused, or a file cannot be written."""
    assert messages.Message(file, "no whole line in it", "LogError").suggestion == ""
    worded = messages.Message(file, "no line in it: name another log", "LogError")
    assert worded.suggestion == "name another log"


@pytest.mark.parametrize("words", ["kind is one of ...", "reason must say why", "lacks ..."])
def test_what_is_wrong_in_a_file_of_edits_stands_in_the_table(words: str) -> None:
    """Collected into one error, whose own words are the number of the edit."""
    assert "formats/edit_files.py" in {e.file for e in messages.gathered() if e.text == words}


def test_no_suggestion_is_left_of_words_that_nothing_says() -> None:
    """It no longer stood beside a message that had been reworded."""
    reported = "\n".join(entry.text for entry in messages.gathered())
    unsaid = [words for words in messages.BY_WORDS if words not in reported]
    assert unsaid == ["Permission denied"]  # the system's words


@pytest.mark.parametrize(
    "words",
    [
        "frames have no odometry near their stamp", "frames repeat a timestamp; duplicates dropped",
        "the recording was not closed", "a message of ...: ...", "silent for ... s",
        "scans match nothing seen before", "visual tracking lost in ... frames",
        "lines give no laser mount", "has the wrong sign",
        "header stamps step back", "ambiguous: another place nearby",
        "contradicts the rest of the graph", "is stamped ... s ... than the", "no intrinsics",
        "the clock was set back by ... s while recording",
    ],
)  # fmt: skip
def test_what_a_map_lacks_stands_in_the_table_as_well(words: str) -> None:
    assert any(words in entry.text for entry in messages.gathered())


def test_what_is_only_logged_needs_no_suggestion() -> None:
    logged = ("closures believed", "pairs of scans, moved by", "done before with the same inputs")
    texts = [entry.text for entry in messages.gathered()]
    assert [text for text in texts if any(words in text for words in logged)] == []


@pytest.mark.parametrize(
    "beginning",
    [
        "Tracking was lost. The map has ... components with unknown relative pose.",
        "Global optimality not certified (", "Global optimality certified (gap", "not localised",
        "pose known for ... of ... ... (after smoothing)", "no time offset between ... and ...",
        "normalised residual (1 = consistent with the stated covariance)",
        "Show time and memory per stage.", "Stop cleanly above this limit; the build",
        "... frames repeat a timestamp; duplicates dropped", "hand-held camera: ",
        "recorded odometry against visual odometry over ...", "gravity estimated from ...",
        "degenerate from ... s to ... s (... m, corridor): position along it relies on odometry",
        "residual ..., ... deg (... sigma, limit ...)",
        "consistent with ... of ... nearby closures",
        "Voxel size [m].", "Maximum depth [m].", "could not be matched and have no odometry",
        "Diagnosis of the sensors", "click for the evidence",
    ],
)  # fmt: skip
def test_a_message_is_found_by_its_beginning(beginning: str) -> None:
    """Errors, notes, output of commands, help, headings and what the report's script shows."""
    page = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8")
    assert beginning in page


def test_what_commands_print_is_on_the_page() -> None:
    """Looked for in the source by other means than the page is made."""
    page = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8").replace("\\_", "_")
    found = [
        beginning
        for path in sorted((ROOT / "cli").rglob("*.py"))
        for beginning in re.findall(
            r'(?:click\.echo|lines\.append|note)\(\s*f?"([\w ,:;-]{12,})', path.read_text("utf-8")
        )
    ]
    assert len(found) > 10
    assert [beginning for beginning in found if " ".join(beginning.split()) not in page] == []


@pytest.mark.parametrize(
    ("text", "suggestion"),
    [
        ("cannot be written: it is a folder", "check the folder"),
        ("is in use by another program: close it there and try again", "close it there"),
        ("was changed or removed while it was read", "give the same command again"),
    ],
)
def test_messages_of_writers_and_their_suggestions(text: str, suggestion: str) -> None:
    fitting = [entry for entry in messages.gathered() if text in entry.text]
    assert fitting
    assert all(suggestion in entry.suggestion for entry in fitting)

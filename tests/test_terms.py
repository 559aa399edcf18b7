"""One word per concept, the field's: the words of before are in no code, no docs and no output."""

from __future__ import annotations

import re
import subprocess

import pytest
from conftest import ROOT

# What a concept was called, as a regular expression that means it and no plain English; what it is
# called now; and a text that must be found.
TERMS = (
    (r"[Kk]eyscan", "keyframe", "the newest keyscan"),
    (
        r"\bislands?\b|\b[Cc]onnected parts?\b|\b[Pp]arts? of the path\b|\bparts that nothing\b",
        "connected component",
        "parts of the path",
    ),
    (
        r"\bparts of (?:one|a) drive\b|_one_drive\b"
        r"|\bclass Unit\b|\bload_unit\b|\bstretch(?:es)? of the (?:path|drive)\b",
        "session",
        "these are no parts of one drive",
    ),
    (
        r"\btracking br(?:oke|eaks?)\b|\bbreaks? of tracking\b|\bis_break\b|laser_breaks"
        r"|\b(?:after|across|spans) (?:a|the) break\b",
        "tracking loss",
        "where tracking breaks",
    ),
    (r"laser_lost|\bsearched widely\b", "wide search, global search", "laser_lost.py"),
    (r"laser_joins|doubt_joins", "session joining", "laser_joins.py"),
    (r"[Ll]ook-?alikes?\b", "perceptual aliasing, alias", "laser_lookalikes.py"),
    (r"laser_review|review_closures", "loop closure refinement", "review_closures(c)"),
    (r"part_maps?\b|part_fits|PartMap", "submap verification", "part_fits.py"),
    (
        r"laser_stretches|leaves_(?:turn_)?open|\b(?:one|a) direction open\b|WeakStretches",
        "degenerate direction, degeneracy",
        "the scans leave one direction open",
    ),
    (r"laser_trust", "odometry faults", "laser_trust.py"),
    (r"felt_force|FeltForce|\bfelt force\b|accelerometer felt", "gravity direction", "FeltForce()"),
    (r"visual_doubts|\bDoubts\b", "tracking quality", "visual_doubts.py"),
    (
        r"(?i)\bsurpris(?:e|es|ing)\b|_SURPRISE\b",
        "normalised innovation squared (NIS)",
        "_SURPRISE",
    ),
    (r"(?i)misfit", "normalised residual", "misfits_of(c)"),
    (r"(?i)\btwins?\b|\btwin_", "convex relaxation", "the twin's minimum"),
    (r"\bwindings?\b|\bwound_starts\b", "wraparound hypotheses", "windings.py"),
    (r"(?i)\bsuppos(?:ition|ed)\b", "group hypothesis", "supposition.py"),
    (r"(?i)\badmi(?:ssion|ssible|tted)\b", "inlier recovery", "admitted by admission"),
    (r"\b_?settled?\b", "optimise, optimised", "from settled poses"),
    (
        r"\bimport Seeker\b|\bclass Seeker\b|\.hear\(|seeking\.py",
        "add_match",
        "seeker.hear(moment)",
    ),
    (r"(?i)\bsurroundings\b", "environment sensors, environment", "surroundings.py"),
    (r"\bnodes\.loose\b|\bloose_way\b", "distance to the last closure", "nodes.loose[a]"),
    (r"\breaches=|\breaches: |_REACHES\b", "max correspondence distances", "reaches=FINE"),
    (r"\bsuccession\b", "sequence matching", "in succession"),
    (r"(?i)\brivals?\b|laser_rival", "ambiguity ratio, second best", "a rival pose"),
    (r"share_sigma|floor_sigma", "relative and absolute odometry noise", "odometry.share_sigma"),
    (
        r"(?:laser|refine)_(?:passes|visits)|_of_(?:passes|visits)\b",
        "revisits",
        "odometry.refine_passes",
    ),
    (r"from_from_to", "relative pose i_from_j", "c.from_from_to"),
    (
        r"\b(?:nothing|scans?|images?|wheels|odometry|stamps|sensors?|covariances|residuals|data"
        r"|match(?:es)?|laser|camera) (?:tells?|told|says?)\b"
        r"|\btold (?:by|of|apart|from)\b|\btells? (?:of|nothing|apart)\b|_told_of_|\btold_of_",
        "report, measure, indicate",
        "what wheels tell",
    ),
    (
        r"\b[Hh]ow sure\b|\bsureness\b|\b(?:not|too|as|less|no) sure\b"
        r"|\b(?:surely|surer|surest|unsure)\b",
        "confident, confidence; covariance",
        "how sure it is",
    ),
    (r"\bm(?:etres)? of way\b|\blong way was driven\b|_LEAST_WAY\b", "path, distance", "m of way"),
    (r"\bturn of (?:the|a) map\b|\bother turns\b", "rotation", "starts with other turns"),
    (
        r"\bMetres a (?:voxel|cell)\.|\bDepth used up to\b",
        "voxel size [m], maximum depth [m]",
        "Metres a voxel.",
    ),
    (r"(?i)remed(?:y|ies)\b", "fix, suggestion", "with its remedy"),
    (
        r"no solution costs less than|lost 0 times|1x is honest|very stamp of the one before: taken"
        r"|Stop in order beyond|Say what it took|\bwheels against images\b|leave the setting away"
        r"|by looking back from later ones|is to be seen in how both saw|closures near it agree",
        "the message as the glossary has it",
        "leave the setting away",
    ),
)
PLAIN = (
    "part of the page; the parts of a mesh; two parts of a split bag", "the robot turns left",
    "a loose cable, a loose bound", "make sure that it is sure to work", "this way, by the way",
    "tell the user what the page says", "the robot was driven", "it breaks down; break", "a unit",
    "an unbroken line", "the search reaches 15 m", "visits every cell", "passes a test",
)  # fmt: skip
_NOT_OURS = re.compile(
    r"docs/images/|sample_logs/|formats/report/assets/(lib|uPlot|LICENSES)|LICENSE$"
    r"|tests/test_terms\.py$"
)


def texts() -> list[tuple[str, str]]:
    """Name and text of every tracked text file that is ours."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    names = [name for name in listed.split("\0") if name and not _NOT_OURS.match(name)]
    found = []
    for path in (ROOT / name for name in names):
        if path.is_file():
            data = path.read_bytes()
            if b"\0" not in data:
                found.append((path.relative_to(ROOT).as_posix(), data.decode("utf-8", "ignore")))
    return found


def test_the_words_of_before_are_nowhere() -> None:
    """In names of files, code, docs, and in what is printed: docs/messages.md lists it."""
    assert len(texts()) > 700
    wrong = []
    for name, text in texts():
        for pattern, better, _ in TERMS:
            wrong += [f"{name}: its name: {better}"] if re.search(pattern, name) else []
            for found in re.finditer(pattern, text):
                line = text.count("\n", 0, found.start()) + 1
                wrong.append(f"{name}:{line}: {found[0]!r}: {better}")
    assert wrong == []


@pytest.mark.parametrize(("pattern", "better", "sample"), TERMS)
def test_each_word_is_found_and_its_replacement_is_not(
    pattern: str, better: str, sample: str
) -> None:
    assert re.search(pattern, sample)
    assert not re.search(pattern, better)


@pytest.mark.parametrize("text", PLAIN)
def test_plain_english_is_left_alone(text: str) -> None:
    assert [pattern for pattern, *_ in TERMS if re.search(pattern, text)] == []


def test_no_two_modules_share_a_name() -> None:
    """So that a name says the room; packages' own files have none."""
    names = [name.rpartition("/")[2] for name, _ in texts() if name.endswith(".py")]
    names = [name for name in names if name != "__init__.py"]
    assert sorted({name for name in names if names.count(name) > 1}) == []

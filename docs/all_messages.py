"""Every message about bad input, gathered from the code, each with what to do about it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mapmyworld.types.wording import _SOURCES, _VERDICTS

ROOT = Path(__file__).parent.parent
_SHORTEST = 10  # letters of a suggestion; less is a word and a value
_PACKAGES = ("cli", "formats", "mapmyworld")
# Messages of these end in words that say what to do, more often than not.
_VERBS = (
    "add", "allow", "ask", "build", "change", "check", "choose", "close", "convert", "copy",
    "correct", "expected", "export", "finish", "free", "give", "have the", "install",
    "is it running", "keep", "leave", "make", "map it", "merge", "name", "pip", "please", "put",
    "raise", "record", "run", "say where", "set", "state", "turn", "try", "update", "use",
    "wait", "write",
)  # fmt: skip
# What to do where the message does not say it itself but contains these words: the first that fits.
BY_WORDS = {
    "cannot be written": "check the folder, its permissions and the space on its disk",
    "its folder does not exist": "make the folder, or give another place with `-o`",
    "it is a folder": "give the name of a file",
    "there is no such file": "check the path",
    "cannot be read": "check the path and its permissions, and that the file is whole",
    "cannot be fetched": "check the address and that its server answers",
    "Permission denied": "read as its owner, or change its permissions",
    "no such map": "check the path; `mapmyworld build` makes maps",
    "is not valid TOML": "correct the line that is named",
    "has no node": "`mapmyworld inspect graph MAP` lists the nodes",
    "there is no node": "`mapmyworld inspect graph MAP` lists the nodes",
    "exclude each other": "omit one of them",
    "goes with none of": "omit the others",
    "has no grid": "build the map to its end, from a log with scans or depth",
    "cannot be opened": "check the path and its permissions",
    "no log given": "name a file or a folder of a kind that [logs](logs.md) lists",
    "no log in this folder": "name a file or a folder of a kind that [logs](logs.md) lists",
    "not a log this program knows": "name a file or a folder of a kind that [logs](logs.md) lists",
    "neither a rosbag2 nor": "name the recording, or a map of `mapmyworld` or RTAB-Map",
    "not an MCAP file": "name a whole MCAP file",
    "no whole FLASER": "name a whole CARMEN log",
    "rosbag migrate": "convert it with `rosbag migrate`",
    "lines give no laser mount": "set sensing.scan_mount",
    "are not one session": "map each (`mapmyworld batch`), or join their maps (`merge`)",
    "a ROS 1 bag cannot hold": "write .mcap or .db3",
    "so it is no mount": "set sensing.scan_mount, or use the log as it was recorded",
    "none of its files": "copy the recording again, or repair it (see above)",
    "the file is empty": "copy it again, or record anew",
    "list no images": "correct the paths in rgb.txt and depth.txt, or copy the folder again",
    "damaged SQLite file": "copy it again, or repair it (see above)",
    "no camera_matrix": "correct the calibration that is named",
    "is a database, but neither": "give a map of `mapmyworld` or RTAB-Map",
    "is a folder, not a map": "give the map's file",
    "holds no nodes": "build the map to its end",
    "has no visual words": "give a map made with a camera",
    "holds no covariances": "build it with graph.covariances = true",
    "has no covariances": "build it with graph.covariances = true",
    "no accepted closure": "draw something else with `--what`",
    "no topic": "`mapmyworld inspect log LOG` lists the topics",
    "nothing to write": "ask for more with `--start`, `--duration` and `--topic`",
    "this node has no image": "`mapmyworld export images` writes those that there are",
    "no message of the selection": "ask for more with `--start`, `--duration` and `--topic`",
    "fx fy cx cy": "correct the calibration that is named",
    "a cloud without points": "it is left out; see that the lidar looks beyond the robot",
    "was a clock set while recording": "keep clocks in step (chrony), and set none while recording",
    "log times are out of order": "nothing; next time set no clock while recording",
    "no camera images": "record colour, depth and camera_info",
    "the camera is not used": "correct what its driver puts into camera_info, and record again",
    "is listed but has no message": "see that its driver runs before the next recording",
    "messages looked at cannot be decoded": "check the driver; the sound messages are used",
    "sampled ranges are NaN": "nothing, unless they are many: then check the laser",
    "a localiser was running": "nothing; its map is not used",
    "leading slash": "nothing; frames are found all the same",
    "no /tf_static": "record it, or set sensing.scan_mount and sensing.camera_mount",
    "no header stamps": "have the driver fill header.stamp",
    "clocks disagree": "keep the machines' clocks in step (chrony, PTP)",
    "when each beam was taken": "nothing, or have the driver fill time_increment",
    "of scans where the robot turns": "nothing, or have the driver fill time_increment",
    "deskewed: ": "nothing, or have the driver fill time_increment",
    "ms per radian": "nothing, or have the driver fill time_increment",
    "3D points serve as flat scans": "nothing; turn slowly, or record a planar laser as well",
    "no odometry in the log": "nothing; with odometry long corridors come out better",
    "reports no motion of": "name a topic of those that do, or omit the setting",
    "topics are set that the log": "correct the names; `mapmyworld inspect log LOG` lists them",
    "was its driver stopped": "check driver and cable before the next recording",
    "angles are not finite": "the scan is left out; check the driver",
    "they show ... deg": "nothing; it is used where no better sensor is",
    "beams over ... deg": "nothing; it is used where no better sensor is",
    "scans of at least two times": "have the driver fill header.stamp",
    "no range in the log is usable": "see that ranges are in metres, from range_min to range_max",
    "not a level scan": "mount it level, or correct its mount: tf, or sensing.scan_mount",
    "none of its messages can be decoded": "record it with its standard type",
    "holds a point": "see that the lidar looks beyond the robot",
    "field of view too narrow": "nothing; a camera's points are no scan",
    "is not in the log; ": "correct the name; `mapmyworld inspect log LOG` lists the topics",
    "after the other sensors": "start the recording when all drivers run",
    "s before the log ends": "check driver and cable before the next recording",
    "silent for": "check driver and cable before the next recording",
    "scans match nothing": "see that ranges are in metres, angles in radians",
    "components with unknown": "`mapmyworld inspect graph` lists them, `edit` can join them",
    "components that no": "`mapmyworld inspect graph` lists them, `edit` can join them",
    "degenerate from ... s to": "nothing; record odometry, or pass such places twice",
    "odometry ... at ... of ... scans": "check the wheels' encoders and stamps",
    "shorter losses": "light the place, turn slowly, or record wheels as well",
    "camera position uncertain": "keep textured things within 5 m in view, or record wheels",
    "visual tracking lost": "light the place, turn slowly, or record wheels as well",
    "recorded and visual odometry differ": "see whether wheels slipped or something moved in view",
    "stamps are shifted by": "nothing; or correct the stamps where they are made",
    "recorded odometry against visual odometry": "nothing; or calibrate the wheels",
    "no depth image near their stamp": "raise sensing.image_tolerance, or have stamps corrected",
    "frames could not be decoded": "check the driver; the sound messages are used",
    "other messages could not be decoded": "check the driver; the sound messages are used",
    "frames repeat a timestamp": "nothing; was the log written twice?",
    "no odometry near their stamp": "keep the machines' clocks in step; check the odometry's rate",
    "image(s) left out: not decodable": "check the driver; the sound images are used",
    "the robot stood still": "drive it through the place that is to be mapped",
    "places do not go with": "look there in the report; `edit` adds and rejects constraints",
    "limits.unpacked_gb": "set it higher if the size is right; else copy the log again",
    "limits.chunk_mb": "the chunk is left out; set limits.chunk_mb higher if its size is right",
}  # fmt: skip
_LOGS = "formats/logs/"
"""Of damage. A `LogError` refuses a log or a message: what helps depends on what it is."""
# What to do where neither does: the longest prefix of the file's path counts. None is for all of
# formats/: what helps with a file that is read is false advice for one that is written.
SUGGESTIONS = {
    "cli/": "correct the command; `--help` shows how it is written",
    "formats/converting": "name the kind of log by the ending of the output",
    "formats/database/": "the map is damaged: build it again from its log with `--overwrite`",
    "formats/edit_files": "correct the line of the edits file that is named",
    "formats/graph": "correct the line of the graph file that is named; the rest is used",
    "formats/grid_files": "write the grid again (`mapmyworld export grid`), or correct its YAML",
    "formats/image_folders": "check the folder, its disk and its permissions",
    _LOGS: "the rest of the log is used; copy it again, or repair it (see above)",
    "formats/logs/carmen": "the line is left out; copy the log again, or repair it (see above)",
    "formats/logs/decoding": "the message is left out; check the driver, or use the standard type",
    "formats/logs/image_pixels": "the image is left out; check the driver",
    "formats/logs/tum_rgbd": "the lines are left out; correct them, or copy the folder again",
    "formats/cloud_files": "write it again: by `mapmyworld export cloud`, or as binary PLY",
    "formats/recording_files": "give another place or name, or `--overwrite`",
    "formats/relation_files": "correct the line of the relations file that is named",
    "formats/report/": "build the map to its end first",
    "formats/scene": "export the mesh again as PLY, OBJ or GLB, with faces",
    "formats/transcoding": "the message is left out: convert into .mcap, which keeps its bytes",
    "formats/trajectory_files": "correct the line of the trajectory file that is named",
    "formats/truth_files": "record the simulated log again, with its truth",
    "formats/vocabulary_files": "write the words again: `mapmyworld export vocabulary MAP`",
    "mapmyworld/config/": "`mapmyworld config` lists every setting with its type and meaning",
    "mapmyworld/diagnosis/": "`mapmyworld inspect log LOG` says beside it what to do",
    "mapmyworld/odometry/": "see there in the report, and at `mapmyworld inspect node MAP ID`",
    "mapmyworld/evaluation/": "check that both files are of the same drive and clock",
    "mapmyworld/backend/": "`mapmyworld inspect graph` shows nodes and constraints",
    "mapmyworld/graph/": "`mapmyworld inspect graph` shows nodes and constraints",
    "mapmyworld/localisation/": "build the map to its end with the sensor that localises",
    "mapmyworld/mapping/": "check ranges and mounts: `mapmyworld inspect log LOG`",
    "mapmyworld/particles/": "FastSLAM needs laser scans and odometry: `mapmyworld inspect log`",
    "mapmyworld/places/": "choose a node with an image: `mapmyworld inspect node MAP ID`",
    "mapmyworld/sensing/": "`mapmyworld inspect log LOG` says what there is and what is missing",
    "mapmyworld/simulation/": "`mapmyworld simulate --settings` and `--list` show what there is",
    "mapmyworld/stages/": "record the sensors that the method needs",
    "mapmyworld/types/wording": "nothing; `mapmyworld edit` can accept or reject the constraint",
    "mapmyworld/": "check the inputs that are named",
}  # fmt: skip


@dataclass(frozen=True, slots=True, order=True)
class Message:
    """One message as its source has it, with ... for what varies."""

    file: str
    text: str
    kind: str
    """The error, or "loss" or "note" of a plan."""

    @property
    def suggestion(self) -> str:
        """What to do: the message's own last words, or what helps with all of its package."""
        for part in (
            self.text.rsplit(": ", 1),
            self.text.rsplit("; ", 1),
            self.text.rsplit("(", 1),
        ):
            own = part[1].rstrip(")") if len(part) == 2 else ""
            if own.lower().lstrip("`").startswith(_VERBS) and len(own) >= _SHORTEST:
                return own
        if reported := next((do for words, do in BY_WORDS.items() if words in self.text), None):
            return reported
        fitting = [prefix for prefix in SUGGESTIONS if self.file.startswith(prefix)]
        if self.kind == "LogError" and _LOGS in fitting:
            fitting.remove(_LOGS)
        return SUGGESTIONS[max(fitting, key=len)] if fitting else ""


def gathered() -> list[Message]:
    """All messages, by file."""
    found = set[Message]()
    for package in _PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            tree = ast.parse(path.read_text("utf-8"))
            for node in ast.walk(tree):
                reported = {
                    Message(name, text, kind) for kind, text in _messages_in(node) if len(text) > 8
                }
                found |= {one for one in reported if not _is_on_a_page(one)}
            found |= {Message(name, text, "problem") for text in _faults(tree)}
            if name.startswith(REASONING):
                known = "\n".join(one.text for one in found)
                found |= {Message(name, t, "reason") for t in _reasons(tree) if t not in known}
    return sorted({*found, *_verdicts()})


# Packages that say why something was chosen or not: in the plan, in the diagnosis and in the
# report. What they say is looked for here as well, so all of it is listed.
REASONING = (
    "mapmyworld/sensing/", "mapmyworld/odometry/", "mapmyworld/places/", "mapmyworld/stages/",
    "mapmyworld/diagnosis/", "mapmyworld/backend/certificate", "mapmyworld/graph/solved_graph",
)  # fmt: skip


def _verdicts() -> Iterator[Message]:
    """Why a constraint is believed or not, as it stands beside it."""
    for words in (*_SOURCES.values(), *_VERDICTS.values()):
        text = re.sub(r"\{[^}]*\}", "...", words)
        if len(text.replace("...", " ").split()) >= _PHRASE:
            yield Message("mapmyworld/types/wording.py", text, "reason")


def _reasons(tree: ast.Module) -> Iterator[str]:
    """All texts of three words or more in functions, without docstrings."""
    for function in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
        yield from (t for t in _texts(function) if len(t.replace("...", " ").split()) >= _PHRASE)


def _is_on_a_page(reported: Message) -> bool:
    """Whether it is a line of a report about what went well."""
    return reported.file.startswith("formats/report/") and reported.kind in {"loss", "note"}


def _messages_in(node: ast.AST) -> Iterator[tuple[str, str]]:
    if isinstance(node, ast.FunctionDef) and node.name in WRITERS:
        texts = (
            _template(n.value) for n in ast.walk(node) if isinstance(n, ast.Return) and n.value
        )
        yield from (("MapError", text) for text in texts)
    if isinstance(node, ast.FunctionDef) and node.name in NOTE_WRITERS:
        yield from (("note", text) for text in _sentences(node))
    if isinstance(node, ast.Yield) and isinstance(node.value, ast.JoinedStr):
        yield from (("loss", text) for text in [_template(node.value)] if len(text) >= _SENTENCE)
    if isinstance(node, ast.Assign) and _is_a_doubt(node.targets[0]):
        yield "loss", _template(node.value)
    if not isinstance(node, ast.Call) or not node.args:
        return
    if isinstance(node.func, ast.Name) and node.func.id == "_require":
        yield "MapError", _template(node.args[-1])
    if isinstance(node.func, ast.Name | ast.Attribute):
        name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
        if name.endswith("Error") and name not in _NOT_OURS:
            yield name, _template(node.args[0])
    if isinstance(node.func, ast.Attribute) and node.func.attr in {"append", "insert"}:
        owner = node.func.value
        name = getattr(owner, "attr", getattr(owner, "id", "")).lstrip("_")
        if name in {"losses", "doubts", "warnings", "problems"}:
            kind = {"losses": "loss", "doubts": "loss", "warnings": "note"}.get(name, "problem")
            last = node.args[-1]  # of a doubt, a topic and the words
            yield kind, _template(last.elts[-1] if isinstance(last, ast.Tuple) else last)


def _faults(tree: ast.Module) -> Iterator[str]:
    """Words of a file's ValueErrors, where it puts them into a message of its own."""
    nodes = list(ast.walk(tree))
    if any(isinstance(n, ast.ExceptHandler) and _passes_words_on(n) for n in nodes):
        for node in nodes:
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
                text = _template(node.exc.args[0])
                if ast.unparse(node.exc.func) == "ValueError" and len(text) > 8:
                    yield text


def _passes_words_on(handler: ast.ExceptHandler) -> bool:
    shown = (
        name.id
        for part in ast.walk(handler)
        if isinstance(part, ast.FormattedValue)
        for name in ast.walk(part)
        if isinstance(name, ast.Name)
    )
    caught = "" if handler.type is None else ast.unparse(handler.type)
    return "ValueError" in caught and handler.name in set(shown)


def _is_a_doubt(target: ast.expr) -> bool:
    return isinstance(target, ast.Subscript) and getattr(target.value, "attr", "") == "doubts"


def _sentences(function: ast.FunctionDef) -> Iterator[str]:
    """All longer texts in a function, without its docstring and what is part of another."""
    yield from (text for text in _texts(function) if len(text) >= _SENTENCE)


def _texts(function: ast.FunctionDef) -> Iterator[str]:
    """All texts in a function, without docstrings, what is logged and what is part of another."""
    within = {
        id(part) for n in ast.walk(function) if isinstance(n, ast.JoinedStr) for part in n.values
    }
    within |= {id(s.value) for s in ast.walk(function) if isinstance(s, ast.Expr)}
    within |= {id(part) for n in ast.walk(function) if _is_logged(n) for part in ast.walk(n)}
    reported = (n for n in ast.walk(function) if isinstance(n, ast.expr) and id(n) not in within)
    yield from (_template(n) for n in reported if not isinstance(n, ast.BinOp))


def _is_logged(node: ast.AST) -> bool:
    """Whether it writes into the log of `--debug`: that lists what was done, nothing is amiss."""
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") == "decided"


_PHRASE = 3  # words of a reason that says something by itself
_SENTENCE = 24  # letters of a text that says something by itself
# Functions that list what a user should know, or say why a sensor is not used.
NOTE_WRITERS = {
    "losses", "lines", "notes", "check_silence", "_judge", "_judge_clouds", "_open_lines",
    "_blind_lines", "contradiction", "_lag_notes",
}  # fmt: skip
# Functions that word a message which others raise.
WRITERS = {"_suggestion", "_nothing_common"}
_NOT_OURS = {
    "ValueError", "TypeError", "RuntimeError", "KeyError", "AssertionError", "AttributeError",
}  # fmt: skip


def _template(node: ast.expr) -> str:
    """The text of a string, with ... for every value; of anything else nothing."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return _one_line(node.value)
    if isinstance(node, ast.JoinedStr):
        parts = [v.value if isinstance(v, ast.Constant) else "..." for v in node.values]
        return _one_line("".join(str(part) for part in parts))
    if isinstance(node, ast.BinOp):
        return _one_line(_template(node.left) + _template(node.right))
    return ""


def _one_line(text: str) -> str:
    return re.sub(r"^(\.\.\.: )+", "", " ".join(text.split()))


def page() -> str:
    """The table, as Markdown."""
    lines = [_HEAD]
    for package, title in _TITLES.items():
        rows = [reported for reported in gathered() if _package(reported.file) == package]
        lines += [f"## {title}", "", "| message | what to do | kind |", "| --- | --- | --- |"]
        seen = dict.fromkeys(
            (reported.text, reported.suggestion, reported.kind) for reported in rows
        )
        lines += [f"| {_cell(text)} | {_cell(do)} | {kind} |" for text, do, kind in seen]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _package(file: str) -> str:
    return max((name for name in _TITLES if file.startswith(name)), key=len)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*").replace("_", "\\_")


_TITLES = {
    "formats/logs/": "Logs",
    "mapmyworld/sensing/": "The plan: topics, frames, clocks",
    "formats/database/": "Maps",
    "formats/": "Other files",
    "mapmyworld/": "Building and scoring",
    "cli/": "Commands",
}
_HEAD = """# Troubleshooting: every message, and what to do

The map is there, and wrong? [Symptoms](symptoms.md), with pictures. Below: what a message means.

Written by `python docs/generate.py` from the code; do not edit. `...` stands for what varies. A
message names the file or topic before it. Errors end a command with exit code 2; a loss makes a
map partial (exit code 3); a note changes nothing; a reason stands beside what was chosen, and
believed or not: in the plan, the diagnosis, the report, or `mapmyworld inspect graph`.
`mapmyworld inspect log LOG` shows losses and notes with the suggestion of each before you build.

Damaged logs can be repaired by the tools of their formats: `mcap recover broken.mcap -o
whole.mcap`, `rosbag reindex broken.bag`, `sqlite3 broken.db3 .recover | sqlite3 whole.db3`. It is
seldom worth it: what they recover is read here as it is.

Behind the name of a file may stand the system's own words:

| message | what to do |
| --- | --- |
| No such file or directory | check the path |
| Permission denied | read as its owner, change its permissions, or give another place |
| Is a directory, Not a directory | give the name of a file, or of a folder |
| No space left on device, Disk quota exceeded | free some space and give the same command again |
| Read-only file system | give a place that can be written to with `-o` |
| Input/output error | copy the file from the disk while it can be read; then try the copy |
"""

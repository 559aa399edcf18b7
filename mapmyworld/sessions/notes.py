"""What a map reports about the sessions in it: their logs, and a digest of all that went in."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict

import mapmyworld
from mapmyworld.config import Config
from mapmyworld.sessions.session_maps import SessionMap
from mapmyworld.types import MapStore


def digest_of(stores: Sequence[MapStore], config: Config) -> str:
    """What went in: the logs, what people stated, the settings; not the names of the files."""
    logs = [((store.get("log") or {}).get("hash"), store.get("edits")) for store in stores]
    text = json.dumps([mapmyworld.__version__, "merge", logs, asdict(config)], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def note_sessions(store: MapStore, session_maps: Sequence[SessionMap], inputs: str) -> None:
    """Which logs the session maps were made of, in their order."""
    logs = [session_map.store.get("log") or {} for session_map in session_maps]
    paths = [path for log in logs for path in log.get("paths", ())]
    listed = [
        entry
        for session_map, log in zip(session_maps, logs, strict=True)
        for entry in _entries(session_map, log)
    ]
    store.put("log", {"hash": inputs, "paths": paths})
    store.put("sessions", listed)


def _entries(session_map: SessionMap, log: dict[str, object]) -> list[dict[str, object]]:
    """What is known of a session map's sessions: a merged map lists its own."""
    known = session_map.store.get("sessions")
    if known:
        return list(known)
    return [
        {"log": log.get("hash"), "paths": log.get("paths", []), "nodes": len(session_map.nodes)}
    ]

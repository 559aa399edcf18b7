"""Routes in text: where the driver goes, one word a step.

0,0 4,0 4,3        drive there, one place after the other
<1,0               drive there backwards
turn:90            turn on the spot, degrees counter-clockwise
wait:2             stand still, seconds
start:1,2,90       begin here, looking at so many degrees (first word only; else the origin)
kidnap:5,5,180     be carried there unseen, wheels still
"""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.errors import WorldError


@dataclass(frozen=True, slots=True)
class Step:
    """One order to the driver."""

    kind: str
    """"drive", "back", "turn", "wait", "start" or "kidnap"."""
    values: tuple[float, ...]


_SIZES = {"turn": 1, "wait": 1, "start": 3, "kidnap": 3}
_HELP = "write places as `x,y`, or <x,y turn:DEG wait:S start:X,Y,DEG kidnap:X,Y,DEG"


def read_route(text: str, laps: int = 1) -> tuple[Step, ...]:
    """The steps of a route, repeated `laps` times but for its start; `WorldError` if unclear."""
    steps = [_step(word) for word in text.split()]
    if not any(step.kind in {"drive", "back", "turn", "wait"} for step in steps):
        raise WorldError(f"route {text!r} leads nowhere: {_HELP}")
    if any(step.kind == "start" for step in steps[1:]):
        raise WorldError("only the first word of a route can be a start; use kidnap:X,Y,DEG later")
    if laps < 1:
        raise WorldError(f"{laps} laps: at least one is needed")
    head = steps[:1] if steps[0].kind == "start" else [Step("start", (0.0, 0.0, 0.0))]
    body = steps[1:] if steps[0].kind == "start" else steps
    return (*head, *body * laps)


def _step(word: str) -> Step:
    kind, colon, rest = word.partition(":")
    if not colon:
        kind, rest = ("back", word[1:]) if word.startswith("<") else ("drive", word)
    size = _SIZES.get(kind, 2)
    try:
        values = tuple(float(value) for value in rest.split(","))
    except ValueError:
        values = ()
    finite = all(abs(value) < 1e6 for value in values)
    if (colon and kind not in _SIZES) or len(values) != size or not finite:
        raise WorldError(f"route: {word!r} is not understood: {_HELP}")
    return Step(kind, values)

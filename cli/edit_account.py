"""What `edit` prints: the constraints that an edit changed, and what fights it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mapmyworld.types import Judged, Poses
from mapmyworld.types.wording import reason_of

_MOST = 40  # changed constraints that are printed: one false statement may cost hundreds
_FIGHTING = 5  # strained constraints that are named


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """A solved graph, before or after an edit."""

    constraints: Sequence[Judged]
    poses: Poses

    @property
    def accepted(self) -> int:
        """How many of the constraints are."""
        return sum(c.accepted for c in self.constraints)


def account(before: Graph, after: Graph, edits: int) -> list[str]:
    """The lines: a summary, then constraint by constraint what became of it."""
    from mapmyworld.graph.edited import changes, farthest_moved, name_of

    node, metres = farthest_moved(before.poses, after.poses)
    found = changes(before.constraints, after.constraints)
    lines = [
        f"{edits} edits applied: {before.accepted} -> {after.accepted} constraints accepted; "
        f"node {node} moved farthest, by {metres:.3f} m"
    ]
    lines += [
        f"  {c.what}: {name_of(c.constraint)}  {reason_of(c.constraint)}".rstrip()
        for c in found[:_MOST]
    ]
    if len(found) > _MOST:
        lines.append(f"  and {len(found) - _MOST} more: `mapmyworld inspect graph --all`")
    return lines


def fight(before: Graph, after: Graph, planar: bool) -> list[str]:
    """The constraints that were accepted without the edits and fit far worse with them."""
    from mapmyworld.graph.edited import in_sigmas, strained

    found = strained((before.constraints, before.poses), (after.constraints, after.poses), planar)
    if not found:
        return []
    lines = [f"{len(found)} constraints contradict the edits; the largest residuals:"]
    return lines + [f"  {in_sigmas(one)}" for one in found[:_FIGHTING]]

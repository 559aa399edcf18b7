"""Sources and verdicts in words a user can act on: the only place that words them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

from mapmyworld.types.constraints import OF_ONE_NODE, Judged
from mapmyworld.types.sources import (
    CameraTracking,
    CorrectedOdometry,
    Given,
    LaserTracking,
    Odometry,
    Particles,
    Person,
    Source,
)
from mapmyworld.types.verdicts import Verdict, Why

_SOURCES: Mapping[type[Source], str] = {
    Given: "{by}",
    Odometry: "recorded odometry",
    CorrectedOdometry: "recorded odometry, by images {distance_share:+.1%} of distance, "
    "{turn_share:+.1%} of rotation and {degrees_per_m:+.2f} deg per m",
    LaserTracking: "scan matching: {state}, overlap {overlap:.0%}",
    CameraTracking: "visual odometry: {state}, {inliers} inliers",
    Particles: "path of the best particle",
    Person: "by hand: {action}: {reason}",
}
"""What no finder judges is worded by its source, everything else by its verdicts."""
_FIT = (
    "residual {residual_length}, {residual_degrees:.2g} deg ({sigmas:.1f} sigma, "
    "limit {sigmas_limit:.1f})"
)
_VERDICTS: Mapping[Why, str] = {
    Why.SCANS_ALIGNED: "overlap {overlap:.0%}, residual {residual:.3f} m",
    Why.NOTHING_IN_COMMON: "no surface seen from both places",
    Why.LITTLE_EVIDENCE: "evidence {evidence:.0f} points, {limit:.0f} needed",
    Why.AMBIGUOUS_POSE: "ambiguous: another pose has evidence {second_best:.0f} against "
    "{evidence:.0f} points; margin {beyond:.0f} with drift",
    Why.NOT_CONVERGED: "not converged: refinement moved the best pose of the search by "
    "{metres:.2f} m, {degrees:.0f} deg",
    Why.DEGENERATE: "degenerate: the surfaces constrain one direction poorly",
    Why.AMBIGUOUS_PLACE: "ambiguous: another place nearby has evidence {second_best:.0f} against "
    "{evidence:.0f} points",
    Why.IMAGES_AGREE: "{inliers} matches agree within {sigmas:g} sigma",
    Why.FEW_INLIERS: "{inliers} of {matches} matches agree, {limit} needed",
    Why.LOW_SHARE: "{share} of the matches agree, {limit} needed",
    Why.UNCERTAIN_TRANSLATION: "translation uncertain: sigma {sigma:.3f} m, limit {limit:g} m",
    Why.UNCERTAIN_ROTATION: "rotation uncertain: sigma {sigma:.4f} rad, limit {limit:g} rad",
    Why.MOTION_CONTRADICTS: "perceptual aliasing: contradicts the tracked motion by {metres:.2f} m "
    "and {degrees:.0f} deg ({sigmas:.1f} sigma)",
    Why.AMBIGUOUS_VIEW: "ambiguous: the same view fits {metres:.1f} m away, and drift may reach "
    "{drift:.1f} m",
    Why.MARKER_CORNERS: "marker {marker}: corners fit within {worst:.1f} sigma (limit {limit:g})",
    Why.CORRECTED: "corrected by images",
    Why.REFUTED: "odometry fault: scans place the robot {metres:.2f} m and {degrees:.0f} deg from "
    "where odometry does",
    Why.DOUBTED: "odometry in doubt: scans fit better {metres:.2f} m and {degrees:.0f} deg from "
    "where it places the robot",
    Why.FAULTS: "odometry in doubt: no scan confirms it, and {faults:.0f} of {sections:.0f} other "
    "sections by odometry alone are faults",
    Why.CONFIRMED: "odometry no longer in doubt: closures fit without a fault",
    Why.ACCEPTED_BY_HAND: "by hand: accepted: {note}",
    Why.REJECTED_BY_HAND: "by hand: rejected: {note}",
    Why.UNUSABLE: "cannot be used: {note}",
    Why.FITS: f"graph: {_FIT}",
    Why.UNSUPPORTED: f"graph: unsupported, may fit by chance: {_FIT}",
    Why.CONTRADICTS: f"graph: contradicts the rest of the graph: {_FIT}",
    Why.MISSES: "graph: residual {sigmas:.1f} sigma",
    Why.MISSES_ALIGNED: "contradicts the refined poses by {metres:.2f} m, {degrees:.1f} deg",
    Why.CARRIED_OVER: "carried over",
    Why.MEASURED_ANEW: "overlap {overlap:.0%}, residual {residual:.3f} m, measured anew from the "
    "refined poses",
}


def reason_of(constraint: Judged) -> str:
    """Why a constraint is accepted or not: what measured it, and every verdict on it."""
    parts = (source_in_words(constraint.source), *map(in_words, constraint.verdicts))
    return " | ".join(part for part in parts if part)


def name_of_ends(kind: str, from_id: int, to_id: int) -> str:
    """A constraint by its kind and its nodes."""
    return f"{kind} on node {from_id}" if kind in OF_ONE_NODE else f"{kind} {from_id} -> {to_id}"


def source_in_words(source: Source) -> str:
    """What measured something; empty for a finder, whose verdicts say it."""
    return _SOURCES.get(type(source), "").format(**asdict(source))


def in_words(verdict: Verdict) -> str:
    """A verdict with its measured values and the limits they met or missed."""
    try:
        text = _VERDICTS[verdict.why].format(note=verdict.note, **_shown(verdict))
    except (LookupError, ValueError, OverflowError):  # a damaged row of a map
        return str(verdict.why)
    return text + _support(verdict.numbers)


def _shown(verdict: Verdict) -> Mapping[str, float | str]:
    """Its numbers; a share that misses its limit does not round up to it."""
    if "residual_metres" in verdict.numbers:
        return {**verdict.numbers, "residual_length": _length(verdict.numbers["residual_metres"])}
    if verdict.why is not Why.LOW_SHARE:
        return verdict.numbers
    share, limit = percent_below(verdict.numbers["share"], verdict.numbers["limit"])
    return {**verdict.numbers, "share": share, "limit": limit}


def _length(metres: float) -> str:
    """Below a centimetre in millimetres, down to tenths."""
    if metres >= 0.01:
        return f"{metres:.3g} m"
    millimetres = 1000 * metres
    return f"{millimetres:.1f} mm" if millimetres < 0.1 else f"{millimetres:.2g} mm"


def _support(numbers: Mapping[str, float]) -> str:
    """Which of the closures near by agree, where the graph asked them."""
    if "partners" not in numbers:
        return ""
    if numbers["partners"] == 0:
        return "; no other closure nearby"
    return f"; consistent with {numbers['supporters']} of {numbers['partners']} nearby closures"


def percent_below(share: float, limit: float) -> tuple[str, str]:
    """Both in percent, the share rounded down: 69% where 0.6996 misses 0.7, not 70%."""
    return f"{math.floor(100 * share)}%", f"{100 * limit:g}%"

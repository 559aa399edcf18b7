"""The stage that streams the log: frames, motion, nodes, neighbour constraints, store."""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np

from mapmyworld.config import Config, SensingConfig
from mapmyworld.decisions import decided, is_heard
from mapmyworld.geometry.rigid import transforms_of_rows
from mapmyworld.odometry.gravity_direction import GravityDirection
from mapmyworld.odometry.tracking_losses import named_moments
from mapmyworld.parallel import batches, in_threads, made_ahead
from mapmyworld.sensing import Plan, read_frames
from mapmyworld.sensing.cloud_scans import thinned
from mapmyworld.sensing.sound_images import ImageGuard
from mapmyworld.sensing.synchronise import FrameCounts
from mapmyworld.stages.first_pass import wheels_of_log
from mapmyworld.stages.nodes import Motion, NodeSelector, Step, neighbours
from mapmyworld.stages.plan_log import stage_of_log
from mapmyworld.stages.trackers import AT_ONCE, Tracker, make_tracker, needs_inertial
from mapmyworld.types import (
    Frame,
    Judged,
    LogSource,
    MapStore,
    NodeData,
    Progress,
    TrackedFrames,
    Why,
)
from mapmyworld.types.wording import source_in_words

if TYPE_CHECKING:
    from mapmyworld.diagnosis import Finding

_LARGE = 8  # frames with images or clouds that pass from thread to thread at once
_LARGEST_LAG = 0.35  # s; near the end of what is tried the least error may lie beyond it
_AHEAD = 4  # such groups that wait for the next thread, at most


def track(
    log: LogSource,
    plan: Plan,
    store: MapStore,
    config: Config,
    progress: Progress,
    tracker: Tracker | None = None,
    lag_s: float = 0.0,
) -> None:
    """Follows the robot through the log; leaves nodes, scans and neighbour constraints.

    `lag_s`: by how much the odometry is known to be stamped later than the laser.
    """
    plan = plan.with_odometry_shifted(-lag_s) if lag_s else plan
    tracker = tracker or make_tracker(plan, config, wheels_of_log(log, plan, config, progress))
    counts, guard = FrameCounts(), ImageGuard()
    writer = _Writer(store, config, guard, wants_images=plan.camera is not None)
    frames = read_frames(
        log, plan, config.sensing, counts, stage_of_log("track", log, progress),
        inertial=needs_inertial(plan),
    )  # fmt: skip
    is_large = plan.camera is not None or (plan.scan is not None and plan.scan.is_cloud)
    together = _LARGE if is_large else AT_ONCE
    _follow(tracker, (_guarded(frame, guard) for frame in frames), writer, together)
    writer.finish()
    refuted = _judge_odometry(store, config)
    faults = [finding for finding in _diagnose(store, plan, config) if not finding.good]
    still = _standing(writer.nodes, counts.frames, config.sensing)
    notes = [*_lag_notes(lag_s), *tracker.notes(), *refuted, *still, *_count_notes(counts)]
    notes += _advice(faults, spoilt=False)
    counted = _count_losses(counts, guard)
    losses = [*log.info().problems, *tracker.losses(), *counted, *_advice(faults, spoilt=True)]
    reported = {"losses": losses, "notes": notes, "odometry_lag_s": lag_s}
    store.put("track", {"frames": counts.frames, **reported})
    for note in _lag_notes(lag_s) if lag_s else notes:  # the others were reported the first time
        progress.note(note)
    store.put("gravity_direction", writer.force.mean())


def odometry_lag(
    log: LogSource, plan: Callable[[], Plan], store: MapStore, config: Config
) -> float:
    """By how many seconds a tracked log's odometry is stamped later than the laser, beyond doubt.

    0 where somebody set its offset, or it was tracked by what was measured already.
    """
    from mapmyworld.diagnosis.lasers import refined_lag
    from mapmyworld.diagnosis.rotation import ODOMETRY_TO_LASER

    if config.sensing.odometry_offset or (store.get("track") or {}).get("odometry_lag_s"):
        return 0.0
    for found in store.get("diagnosis") or ():
        if found["name"] == ODOMETRY_TO_LASER and not found["good"]:
            first = float(found["value"])
            return refined_lag(log, plan(), config, first) if abs(first) < _LARGEST_LAG else 0.0
    return 0.0


def _lag_notes(lag_s: float) -> Iterator[str]:
    if lag_s:
        order = "later" if lag_s > 0 else "earlier"
        yield (
            f"odometry is stamped {abs(lag_s):.3f} s {order} than the laser: its stamps are "
            f"shifted by {-lag_s:+.3f} s; set sensing.odometry_offset to overrule that"
        )


def _follow(tracker: Tracker, frames: Iterator[Frame], writer: _Writer, together: int) -> None:
    """Some frames at a time are read by one thread, followed by another and written by a third."""
    ahead = itertools.chain.from_iterable(made_ahead(batches(frames, together), _AHEAD))
    for _ in in_threads(writer.add_all, batches(tracker.follow(ahead), together), 1, _AHEAD):
        pass


def _diagnose(store: MapStore, plan: Plan, config: Config) -> tuple[Finding, ...]:
    from mapmyworld.diagnosis import diagnose_tracked

    findings = diagnose_tracked(store, plan, config)
    store.put("diagnosis", [asdict(finding) for finding in findings])
    return findings


def _advice(faults: Sequence[Finding], *, spoilt: bool) -> Iterator[str]:
    """Where sensors contradict each other, and what to do; `spoilt`: what makes the map wrong."""
    from mapmyworld.diagnosis.finding import SENSE_OF_TURNING

    for fault in faults:
        if (fault.name == SENSE_OF_TURNING) == spoilt:
            yield f"{fault.text}: {fault.suggestion}"


class _Writer:
    """Puts frames and nodes into the store as they come."""

    def __init__(
        self,
        store: MapStore,
        config: Config,
        guard: ImageGuard,
        *,
        wants_images: bool,
    ) -> None:
        self._store, self._guard = store, guard
        self._cloud_spacing = config.sensing.cloud_spacing
        self._selector = NodeSelector(config.sensing, wants_images=wants_images)
        self._stamps, self._node_ids, self._is_node = array("q"), array("q"), array("b")
        # Of every frame only numbers are kept, 104 bytes a pose: a drive may last for hours.
        self._moved, self._odometry = array("d"), array("d")
        self.force = GravityDirection()

    @property
    def nodes(self) -> int:
        """How many there are."""
        return 0 if self._selector.last is None else self._selector.last.id

    def add_all(self, followed: Sequence[tuple[Frame, Motion]]) -> None:
        steps = [step for frame, motion in followed if (step := self._add(frame, motion))]
        if steps:
            self._store.add_constraints(neighbours(steps))

    def _add(self, frame: Frame, motion: Motion) -> Step | None:
        """Stores a frame; the way to the node that it becomes, if it does and there is one."""
        node, step, node_from_frame = self._selector.consider(frame, motion)
        if is_heard():
            stamp, source = frame.stamp_ns * 1e-9, source_in_words(motion.source)
            became = "no node" if node is None else f"node {node.id}"
            count = len(self._stamps)
            decided("track", f"frame {count} at {stamp:.3f} s: {source}, becomes {became}")
        if node is not None:
            images = tuple(i for image in frame.images if (i := self._guard.sound(image)))
            cloud = None if frame.cloud is None else thinned(frame.cloud, self._cloud_spacing)
            self._store.add_node(node, NodeData(frame.scan, images, cloud))
        last = self._selector.last
        assert last is not None
        if frame.scan is not None:
            self._store.add_scan(len(self._stamps), frame.scan)
        self.force.add(frame.imu, motion.tracked_from_base)
        self._stamps.append(frame.stamp_ns)
        self._node_ids.append(last.id)
        self._moved.extend(node_from_frame[:3].ravel().tolist())
        self._is_node.append(node is not None)
        if frame.odom_from_base is not None:
            self._odometry.extend(frame.odom_from_base[:3].ravel().tolist())
        return step

    def finish(self) -> None:
        complete = len(self._odometry) == len(self._moved) > 0
        self._store.set_tracked_frames(
            TrackedFrames(
                np.array(self._stamps, np.int64),
                np.array(self._node_ids, np.int64),
                transforms_of_rows(self._moved),
                np.array(self._is_node, np.bool_),
                transforms_of_rows(self._odometry) if complete else None,
            )
        )


def _guarded(frame: Frame, guard: ImageGuard) -> Frame:
    if not frame.images:
        return frame
    return replace(frame, images=tuple(guard.guarded(image) for image in frame.images))


def _standing(nodes: int, frames: int, config: SensingConfig) -> Iterator[str]:
    if nodes == 1 < frames:
        yield (
            f"the robot stood still (less than {config.node_distance:g} m and "
            f"{config.node_angle:g} rad): the map shows what is seen from one place"
        )


def _count_notes(counts: FrameCounts) -> Iterator[str]:
    if counts.repeated:
        yield f"{counts.repeated} frames repeat a timestamp; duplicates dropped"


def _count_losses(counts: FrameCounts, guard: ImageGuard) -> Iterator[str]:
    if counts.undecodable:
        yield f"{counts.undecodable} frames could not be decoded and are left out"
    if counts.unusable:
        yield f"{counts.unusable} other messages could not be decoded and are left out"
    if guard.failures:
        yield (
            f"{guard.failures} image(s) left out: not decodable, or of another size; first: "
            f"{guard.reason}"
        )
    if counts.without_odometry:
        yield f"{counts.without_odometry} frames have no odometry near their stamp"
    if counts.unpaired_images:
        yield f"{counts.unpaired_images} colour images have no depth image near their stamp"


def _judge_odometry(store: MapStore, config: Config) -> list[str]:
    """Replaces motions by odometry that later scans refute; one line that says where, if any."""
    from mapmyworld.places.laser_nodes import load_node_scans, nodes_at
    from mapmyworld.places.refuted_odometry import is_unsupported, refuted_odometry

    constraints = store.constraints()
    if not any(is_unsupported(c) for c in constraints):
        return []
    nodes = nodes_at(load_node_scans(store, config), None)
    judged = refuted_odometry(nodes, constraints, config)
    store.judge(judged)
    return _faults(store, judged)


def _faults(store: MapStore, judged: Sequence[Judged]) -> list[str]:
    refuted = [c for c in judged if c.verdicts and c.verdicts[-1].why is Why.REFUTED]
    if not refuted:
        return []
    stamps = {node.id: node.stamp_ns for node in store.nodes()}
    when = named_moments([stamps[c.from_id] for c in refuted], min(stamps.values()))
    found = [c.verdicts[-1].numbers for c in refuted]
    metres, degrees = (max(numbers[key] for numbers in found) for key in ("metres", "degrees"))
    return [
        f"odometry fault after {when}: later scans place the robot up to {metres:.1f} m and "
        f"{degrees:.0f} deg from there; it was carried, or its wheels slipped"
    ]

"""Which kernels a build calls, and with which types: what a first start compiles ahead.

A kernel that is missing here is compiled when it is called, on one core; the tests say which.
"""

from __future__ import annotations

from dataclasses import dataclass

_TABLE = """
scan/scan scan_tracking.track_scans
    i8 f4[:,::1] i8[::1] f8[:,::1] f8[:,::1] f4[:,:,::1] i8[::1] f8[:,::1] f8[:,::1] i8[::1]
    i8[::1] f8[::1] f8[::1] f8[::1] f8[::1] i8 f8[:,::1] f8[:,:,::1]
camera/sight pose_refinement.refine
    f8[:,::1] f8[:,::1] f8[:,::1] f8[:,::1] f8 i8 f8[:,::1]
scan/scan scan_preparation.prepare_many
    f4[:,::1] i8[::1] f8[:,::1] f8[::1] f8[::1] f4[:,::1] i8[::1]
scan branch_and_bound.best_shift
    u1[:,:,::1] i8 f8[:,::1] f8[::1] f8 i8 f8[::1] i8[:,::1] i8 f8[::1] f8 f8[::1] f8[::1]
camera image_matching.match_all
    u8[:,::1] u8[:,::1] i8 f8
odometry/odometry recorded_motion.interpolate_poses
    i8[::1] f8[:,:,::1] i8[::1] i8 f8[:,:,::1]
log rays.count_scans
    u2[:,::1] u2[:,::1] u1[:,::1] i8 f8[:,::1] f8[:,::1] b1[::1] i8[::1]
sight/sight bundle.bundle_normal_equations
    f8[:,:,::1] f8[:,::1] i8[::1] i8[::1] f8[:,::1] f8[:,::1] f8 f8[:,:,::1] f8[:,::1] f8[:,:,::1]
    f8[:,::1] f8[:,:,::1]
scan scan_alignment.pair_systems
    i8 i8 f4[:,::1] i8[::1] f8[:,::1] i8[:,::1] f8[:,::1] f8 f8 f8[:,::1]
camera/sight image_matching.match_projected
    f4[:,::1] f4[::1] u8[:,::1] f4[:,::1] u8[:,::1] f8 i4[::1] i4[::1] i8 i8 f8
camera surfaces.compare_with_depth
    f8[:,::1] f8[:,::1] f8[:,::1] i8 f8[::1] f4[:,::1] f8 f8 i4[::1] i4[::1]
log prediction.predict
    i4[::1] i4[::1] f8[::1] f8[::1] i4[::1] i8[::1] f8[::1] i8[::1] i8[::1] f8[::1]
camera surfaces.surface_normals
    f4[:,:,::1] f4[:,:,::1] f4[:,::1]
camera/scan projection.project_points
    f8[:,::1] f8[:,::1] i8 f8[::1] f8[:,::1]
camera voxels.add_points
    f8[:,::1] u1[:,::1] f4[:,::1] f8 i4[::1] i8[::1] u2[:,::1] i8
sight/sight bundle.subtract_points
    i8[::1] i8[::1] f8[:,:,::1] f8[:,:,::1] f8[:,::1]
camera image_matching.nearest_and_votes
    u8[:,::1] u8[:,::1] i8[::1] i8[:,::1]
camera/sight pose_refinement.score_poses
    f8[:,:,::1] f8[:,::1] f8[:,::1] f8[:,::1] f8 i8[::1]
sight/sight bundle.eliminate_points
    f8[:,:,::1] f8 f8[:,:,::1] i8[::1] f8[:,:,::1] f8[:,:,::1]
camera/sight pose_refinement.squared_errors
    f8[:,::1] f8[:,::1] f8[:,::1] f8[:,::1] f8[:,::1]
scan branch_and_bound.fill_pyramid
    u1[:,:,::1] i8
scan/scan recorded_motion.sort_beams
    f4[::1] f8 f8 f8[:,::1] f8[::1] f8[:,::1] i8[::1] i8[::1]
scan/scan recorded_motion.move_beams
    f8[:,::1] i8[::1] f8 f8[:,:,::1]
camera image_matching.nearest_leaves
    u8[:,::1] u8[:,::1] i4[::1] i4[::1]
sight/sight bundle.move_points
    f8[:,:,::1] f8[:,:,::1] f8[:,::1] i8[::1] i8[::1] f8[:,::1] f8[:,::1]
sight/sight bundle.subtract_gradients
    f8[:,:,::1] f8[:,::1] i8[::1] i8[::1] f8[:,::1]
camera voxels.fill_table
    i4[::1] i8[::1] i8
"""


@dataclass(frozen=True, slots=True)
class FirstKernel:
    """A kernel of `mapmyworld.kernels` as builds call it."""

    needed_by: str
    """What a plan has that makes a build call it; `log` = every build."""
    tracking: frozenset[str]
    """What a plan has that makes tracking call it already; the others have time."""
    module: str
    name: str
    signatures: tuple[str, ...]
    """Types of the arguments, as numba spells them."""


def _read(table: str) -> tuple[FirstKernel, ...]:
    """Kernels in the order of the table, each once with all its signatures.

    An entry says what needs it, and after a slash what needs it while tracking; then which kernel,
    and with which types.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for entry in table.strip().replace("\n    ", " ").split("\n"):
        needs, place, *types = entry.split(" ")
        found.setdefault((needs, place), []).append(", ".join(types) + ",")
    return tuple(
        _kernel(*needs.split("/"), place=place, signatures=tuple(signatures))
        for (needs, place), signatures in found.items()
    )


def _kernel(needed_by: str, *tracking: str, place: str, signatures: tuple[str, ...]) -> FirstKernel:
    module, name = place.split(".")
    return FirstKernel(needed_by, frozenset(tracking), module, name, signatures)


KERNELS = _read(_TABLE)
"""The longest to compile first."""

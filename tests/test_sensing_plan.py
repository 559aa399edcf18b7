"""The plan: what is chosen, what is said, what is refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from messages_in_memory import MemoryLog, camera_info_at, image_at, odometry_at, scan_at, transform

from mapmyworld.config import SensingConfig
from mapmyworld.errors import ConfigError, LogError
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.sensing import Plan, make_plan, survey_log
from mapmyworld.types import ImageMessage, Message

STEP_NS = 100_000_000
Entries = list[tuple[str, Message, int]]


def plan_of(entries: Entries, **settings: object) -> Plan:
    return make_plan(survey_log(MemoryLog(entries)), SensingConfig(**settings))


def drive(frame_id: str = "laser", scan_topic: str = "/scan") -> Entries:
    """Ten scans and ten odometry messages of a straight drive."""
    entries: Entries = []
    for i in range(10):
        time = i * STEP_NS + 1
        entries.append(("/odom", odometry_at(time, (0.1 * i, 0.0, 0.0)), time))
        entries.append((scan_topic, scan_at(time, frame_id=frame_id), time))
    return entries


def with_mount(entries: Entries) -> Entries:
    return [("/tf_static", transform("base_link", "laser", (0.2, 0.0, 0.1)), 0), *entries]


def test_scan_odometry_base_and_mount_are_found() -> None:
    plan = plan_of(with_mount(drive()))
    assert plan.base_frame == "base_link"
    assert plan.planar
    assert plan.scan is not None
    assert matrix_to_planar(plan.scan.base_from_lidar) == pytest.approx([0.2, 0.0, 0.1])
    assert plan.odometry is not None
    assert plan.odometry.name == "/odom"
    assert not plan.losses


def test_odometry_that_never_moves_is_left_out() -> None:
    """Wheels that are not connected: as if the log had no odometry, and another topic is taken."""
    still = [
        ("/odom", odometry_at(i * STEP_NS + 1, (1.0, 2.0, 0.3)), i * STEP_NS + 1) for i in range(10)
    ]
    scans = [entry for entry in with_mount(drive()) if entry[0] != "/odom"]
    plan = plan_of([*scans, *still])
    assert plan.odometry is None
    assert "/odom reports that the robot never moved: left out" in plan.warnings
    moving = [("/wheels", m, t) for topic, m, t in drive() if topic == "/odom"]
    plan = plan_of([*scans, *still, *moving])
    assert plan.odometry is not None
    assert plan.odometry.name == "/wheels"


def test_leading_slashes_and_a_localiser_are_seen_and_survived() -> None:
    entries: Entries = [("/tf", transform("/base_link", "/laser", (0.1, 0, 0), static=False), 0)]
    for i in range(10):
        time = i * STEP_NS + 1
        moved = transform("/odom", "/base_link", (0.1 * i, 0, 0), time, static=False)
        jumped = transform("/map", "/odom", (0.5 * i, 0, 0), time, static=False)
        entries += [("/tf", moved, time), ("/tf", jumped, time)]
        entries.append(("/scan", scan_at(time, frame_id="/laser"), time))
    plan = plan_of(entries)
    assert plan.base_frame == "base_link"
    assert plan.odometry is not None
    assert plan.odometry.name == "tf odom -> base_link"
    text = "\n".join(plan.warnings)
    assert "leading slash" in text
    assert "localiser" in text
    assert "no /tf_static" in text


@pytest.mark.parametrize("robot", ["r1/", "tb3_0_"])
def test_frames_behind_a_robots_name_are_known_by_the_rest(robot: str) -> None:
    """Without it the frame named odom became the base, and the log had no odometry."""
    mount = transform(f"{robot}base_link", f"{robot}laser", (0.2, 0, 0))
    entries: Entries = [("/tf_static", mount, 0)]
    for i in range(10):
        time = i * STEP_NS + 1
        moved = transform(f"{robot}odom", f"{robot}base_link", (0.1 * i, 0, 0), time, static=False)
        drifts = transform(f"{robot}map", f"{robot}odom", (0.01 * i, 0, 0), time, static=False)
        entries += [("/tf", moved, time), ("/tf", drifts, time)]
        entries.append(("/scan", scan_at(time, frame_id=f"{robot}laser"), time))
    plan = plan_of(entries)
    assert plan.base_frame == f"{robot}base_link"
    assert plan.odometry is not None
    assert plan.odometry.name == f"tf {robot}odom -> {robot}base_link"
    assert not plan.losses
    assert f"tf {robot}map -> {robot}odom" in "\n".join(plan.warnings)


def test_a_base_of_any_name_is_what_moves() -> None:
    entries: Entries = [("/tf_static", transform("mower", "lidar_plate", (0.2, 0, 0)), 0)]
    entries += [("/tf_static", transform("lidar_plate", "laser", (0, 0, 0)), 0)]
    for i in range(10):
        time = i * STEP_NS + 1
        moved = transform("start", "mower", (0.1 * i, 0, 0), time, static=False)
        entries += [("/tf", moved, time), ("/scan", scan_at(time), time)]
    plan = plan_of(entries)
    assert plan.base_frame == "mower"
    assert plan.odometry is not None
    assert plan.odometry.name == "tf start -> mower"


@pytest.mark.parametrize("by_topic", [True, False])
def test_a_sensor_that_tf_does_not_connect_is_not_taken_for_the_base(*, by_topic: bool) -> None:
    """Its own frame was: the odometry then reported the motion of an optical frame."""
    entries: Entries = []
    for i in range(10):
        time = i * STEP_NS + 1
        moved = transform("odom", "base_link", (0.1 * i, 0, 0), time, static=False)
        entries += [("/tf", moved, time), ("/scan", scan_at(time), time)]
        entries += [("/odom", odometry_at(time, (0.1 * i, 0, 0)), time)] if by_topic else []
    plan = plan_of(entries)
    assert plan.base_frame == "base_link"
    assert plan.odometry is not None
    assert "no transform from base_link to laser" in "\n".join(plan.losses)


@pytest.mark.parametrize(("child", "lost"), [("imu_link", True), ("base_footprint", False)])
def test_odometry_of_a_frame_that_tf_does_not_know_is_reported(child: str, *, lost: bool) -> None:
    entries: Entries = [("/tf_static", transform("base_link", "laser", (0.2, 0, 0)), 0)]
    for i in range(10):
        time = i * STEP_NS + 1
        entries.append(("/odom", odometry_at(time, (0.1 * i, 0, 0), child=child), time))
        entries.append(("/scan", scan_at(time), time))
    plan = plan_of(entries)
    assert plan.base_frame == "base_link"
    reported = "\n".join(plan.losses if lost else plan.warnings)
    assert f"no transform from {child} to base_link" in reported
    assert bool(plan.losses) == lost


def test_a_robot_that_stands_before_it_drives_has_odometry_from_tf_throughout() -> None:
    """What had not moved yet was taken for fixed, and its times forgotten."""
    entries: Entries = [("/tf_static", transform("base_link", "laser", (0.2, 0, 0)), 0)]
    for i in range(100):
        time = i * STEP_NS // 2
        pose = (max(i - 60, 0) * 0.05, 0.0, 0.0)
        entries.append(("/tf", transform("odom", "base_link", pose, time, static=False), time))
        entries.append(("/scan", scan_at(time), time))
    plan = plan_of(entries)
    assert plan.odometry is not None
    for i in range(100):
        found = plan.odometry.motion.at(i * STEP_NS // 2)
        assert found is not None
        assert found[0, 3] == pytest.approx(max(i - 60, 0) * 0.05)


def test_without_tf_the_mount_is_assumed_and_called_a_loss() -> None:
    plan = plan_of(drive())
    assert "sensing.scan_mount" in "\n".join(plan.losses)
    reported = plan_of(drive(), scan_mount="0.3 0 0.2 0 0 0.5")
    assert reported.scan is not None
    assert "sensing.scan_mount" not in "\n".join(reported.losses)
    assert matrix_to_planar(reported.scan.base_from_lidar) == pytest.approx([0.3, 0.0, 0.5])


def test_without_odometry_the_motion_is_left_to_the_sensors() -> None:
    plan = plan_of([e for e in with_mount(drive()) if e[0] != "/odom"])
    assert plan.odometry is None
    assert "no odometry" in "\n".join(plan.warnings)


def test_a_log_without_scan_and_depth_is_refused_with_all_problems() -> None:
    entries: Entries = [("/odom", odometry_at(i, (0, 0, 0)), i) for i in range(5)]
    entries += [("/rgb/image", image_at(i, "rgb8"), i) for i in range(5)]
    with pytest.raises(LogError, match="neither a laser scan nor colour with depth") as error:
        plan_of(entries)
    assert "no laser scan topic" in str(error.value)
    assert "no depth and camera info" in str(error.value)


def test_an_empty_log_is_refused() -> None:
    with pytest.raises(LogError, match="no message"):
        plan_of([])


def test_a_camera_without_camera_info_is_a_loss_when_there_is_a_laser() -> None:
    entries = with_mount(drive())
    entries += [("/rgb/image", image_at(i * STEP_NS, "rgb8"), i * STEP_NS) for i in range(5)]
    entries += [("/depth/image", image_at(i * STEP_NS, "16UC1"), i * STEP_NS) for i in range(5)]
    plan = plan_of(entries)
    assert plan.camera is None
    assert "record the camera_info topic" in "\n".join(plan.losses)


@pytest.mark.parametrize("laser", [True, False])
def test_images_that_cannot_be_decoded_are_named_with_the_reason(*, laser: bool) -> None:
    """Depth of an encoding that nobody knows passed for colour, and depth for not recorded."""

    def unknown() -> np.ndarray:
        raise LogError("image encoding '64FC1' is not known")

    entries = with_mount(drive()) if laser else []
    for i in range(5):
        time = i * STEP_NS
        entries += [
            ("/rgb/image", image_at(time, "rgb8"), time),
            ("/rgb/camera_info", camera_info_at(time), time),
            ("/depth/image", ImageMessage(time, "optical", "64FC1", 64, 48, unknown), time),
        ]
    reported = "\n".join(plan_of(entries).losses) if laser else refusal_of(entries)
    assert "/depth/image: image encoding '64FC1' is not known" in reported
    assert "no depth" in reported


def refusal_of(entries: Entries) -> str:
    with pytest.raises(LogError, match="no map can be made") as error:
        plan_of(entries)
    return str(error.value)


def test_the_registered_depth_of_the_same_size_wins() -> None:
    entries: Entries = []
    for i in range(5):
        time = i * STEP_NS
        entries += [
            ("/cam/color/image_raw", image_at(time, "rgb8"), time),
            ("/cam/color/camera_info", camera_info_at(time), time),
            ("/cam/depth/camera_info", camera_info_at(time, (32, 24), "depth_optical"), time),
            ("/cam/depth/image", image_at(time, "16UC1", (32, 24), "depth_optical"), time),
            ("/cam/aligned_depth_to_color/image_raw", image_at(time, "16UC1"), time),
        ]
    plan = plan_of(entries)
    assert plan.camera is not None
    assert plan.camera.depth_topic == "/cam/aligned_depth_to_color/image_raw"
    reason = next(d.reason for d in plan.decisions if d.role == "camera")
    assert "/cam/color/camera_info fit" in reason


def test_clocks_that_disagree_are_replaced_by_log_time() -> None:
    late = 5_000_000_000
    entries = [
        (topic, message, time if topic == "/scan" else time + late)
        for topic, message, time in with_mount(drive())
    ]
    plan = plan_of(entries)
    assert plan.use_log_time
    assert "clocks disagree" in "\n".join(plan.losses)


def test_time_that_steps_back_is_reported() -> None:
    entries = with_mount(drive())
    entries.append(("/scan", scan_at(5), 20 * STEP_NS))
    assert "step back 1 times" in "\n".join(plan_of(entries).warnings)


def test_ranges_that_are_nan_are_reported() -> None:
    ranges = np.full(181, 2.0)
    ranges[0] = np.nan
    entries = [
        (topic, scan_at(time, ranges) if topic == "/scan" else message, time)
        for topic, message, time in with_mount(drive())
    ]
    (reported,) = [line for line in plan_of(entries).warnings if "are NaN" in line]
    nan, ranges_seen = (int(text.replace(",", "")) for text in re.findall(r"[\d,]+", reported)[:2])
    assert ranges_seen == 181 * nan


def test_settings_override_and_unknown_topics_are_refused() -> None:
    entries = with_mount(drive()) + drive(scan_topic="/scan_rear")
    assert plan_of(entries, scan_topic="/scan_rear").scan.topic == "/scan_rear"  # type: ignore[union-attr]
    with pytest.raises(ConfigError, match="scans: /scan"):
        plan_of(with_mount(drive()), scan_topic="/nowhere")
    with pytest.raises(ConfigError, match=r"odometry: /odom; did you mean /odom\?"):
        plan_of(with_mount(drive()), odometry_topic="/odmo")
    with pytest.raises(ConfigError, match="reports no motion of base_link; topics that do: /odom"):
        plan_of(with_mount(drive()), odometry_topic="tf")
    assert plan_of(with_mount(drive()), odometry_topic="none").odometry is None


def test_all_topics_that_the_log_lacks_are_refused_at_once() -> None:
    with pytest.raises(ConfigError) as error:
        plan_of(with_mount(drive()), odometry_topic="/odmo", scan_topic="/s", depth_topic="/d")
    names = ["scan_topic", "odometry_topic", "depth_topic"]
    for problem, name in zip(error.value.problems, names, strict=True):
        assert problem.startswith(f"sensing.{name} = ")


@pytest.mark.parametrize(
    ("scans", "word"),
    [
        (
            [scan_at(i * STEP_NS + 1, angle_increment=0.0) for i in range(9)],
            "angle_increment 0 rad",
        ),
        (
            [scan_at(i * STEP_NS + 1, angle_increment=np.nan) for i in range(9)],
            "angle_increment nan",
        ),
        (
            [scan_at(i * STEP_NS + 1, angle_min=-90.0, angle_increment=1.0) for i in range(9)],
            "angles in radians, not degrees",
        ),
        ([scan_at(1)], "a map needs scans of at least two times"),
        (
            [scan_at(i * STEP_NS + 1, np.zeros(181)) for i in range(9)],
            "no range in the log is usable",
        ),
    ],
)
def test_scans_that_no_map_can_be_made_of_are_refused_with_the_reason(
    scans: list[Message], word: str
) -> None:
    entries = [e for e in with_mount(drive()) if e[0] != "/scan"]
    entries += [("/scan", scan, scan.stamp_ns) for scan in scans]  # type: ignore[union-attr]
    with pytest.raises(LogError, match="no map can be made") as error:
        plan_of(entries)
    assert word in str(error.value)
    for i in range(5):
        time = i * STEP_NS
        entries += [
            ("/rgb/image", image_at(time, "rgb8"), time),
            ("/depth/image", image_at(time, "16UC1"), time),
            ("/rgb/camera_info", camera_info_at(time), time),
        ]
    plan = plan_of(entries)  # with the camera alone, and that is said
    assert plan.scan is None
    assert any(word in loss for loss in plan.losses)


def test_a_laser_that_is_blind_for_the_first_half_is_used() -> None:
    def half_blind(i: int) -> Message:
        return scan_at(i * STEP_NS + 1, np.full(181, 2.0 if i > 9 else 0.0))

    entries = [e for e in with_mount(drive()) if e[0] != "/scan"]
    entries += [("/scan", half_blind(i), i * STEP_NS + 1) for i in range(20)]
    plan = plan_of(entries)
    assert plan.scan is not None
    assert not plan.losses


@pytest.mark.parametrize("metres", [np.nan, np.inf, 1e39])
def test_a_transform_to_no_place_on_earth_is_left_out(metres: float) -> None:
    """Also one that is finite: single precision cannot hold it."""
    broken = ("/tf_static", transform("base_link", "laser", (metres, 0.0, 0.0)), 1)
    plan = plan_of([*with_mount(drive()), broken])
    assert plan.scan is not None
    assert matrix_to_planar(plan.scan.base_from_lidar) == pytest.approx([0.2, 0.0, 0.1])


def test_a_tilted_laser_is_not_taken_for_a_level_one() -> None:
    entries = drive()
    with pytest.raises(LogError, match="tilted by 90 deg"):
        plan_of(entries, scan_mount=f"0 0 0 {np.pi / 2} 0 0")


@pytest.mark.parametrize("mount", ["0 0 0 0 0 nan", "nan 0 0 0 0 0", "1e300 0 0 0 0 0"])
def test_a_mount_that_is_no_place_on_a_robot_is_refused(mount: str) -> None:
    with pytest.raises(ConfigError, match="no place on a robot"):
        plan_of(drive(), scan_mount=mount)


def panned(turn: float, offset_ns: int = 0) -> Entries:
    """A drive whose laser sits on a joint that turns by so much in all, stamps so much later."""
    entries: Entries = [("/tf_static", transform("base_link", "pan_base", (0.2, 0, 0.1)), 0)]
    for topic, message, time in drive():
        shifted = replace(message, stamp_ns=message.stamp_ns + offset_ns)
        joint = transform(
            "pan_base", "laser", (0, 0, turn * (time / (9 * STEP_NS) - 0.5)), shifted.stamp_ns,
            static=False,
        )  # fmt: skip
        entries += [("/tf", joint, time), (topic, shifted, time)]
    return entries


@pytest.mark.parametrize("offset_ns", [0, 7200 * 10**9])
def test_a_sensor_on_a_joint_is_found_by_the_stamps_of_tf(offset_ns: int) -> None:
    """It was looked for at the log time: with simulated stamps its mount was called unknown."""
    plan = plan_of(panned(0.02, offset_ns))
    assert plan.scan is not None
    assert plan.scan.base_from_lidar[:2, 3] == pytest.approx([0.2, 0.0])
    assert not plan.losses


def test_a_laser_that_turns_on_the_robot_is_a_loss_and_comes_after_one_that_does_not() -> None:
    """A map was made as if it always looked where it did in the middle of the log, unsaid."""
    plan = plan_of(panned(1.0))
    assert any("laser moves against base_link by up to 0.00 m and 3" in s for s in plan.losses)
    narrow = scan_at(1, np.full(91, 2.0), frame_id="fixed", angle_increment=np.pi / 180)
    fixed: Entries = [("/tf_static", transform("base_link", "fixed", (0.1, 0, 0)), 0)]
    times = [i * STEP_NS + 1 for i in range(10)]
    fixed += [("/scan_fixed", replace(narrow, stamp_ns=time), time) for time in times]
    plan = plan_of(sorted(panned(1.0) + fixed, key=lambda entry: entry[2]))
    assert plan.scan is not None
    assert plan.scan.topic == "/scan_fixed"
    assert not plan.losses


@pytest.mark.parametrize(
    ("time_increment", "timed"), [(0.0005, True), (0.0, False), (-0.0005, False), (0.5, False)]
)
def test_beams_have_times_only_where_a_sweep_ends_before_the_next(
    time_increment: float, *, timed: bool
) -> None:
    """Milliseconds put a beam minutes after its sweep, which was then left as it was, unsaid."""
    scans = [
        (topic, replace(m, time_increment=time_increment) if topic == "/scan" else m, time)
        for topic, m, time in with_mount(drive())
    ]
    plan = plan_of(scans)
    assert plan.scan is not None
    assert plan.scan.beams_are_timed == timed
    assert ("does not say when each beam" in "\n".join(plan.warnings)) == (not timed)


@pytest.mark.parametrize(("focal", "used"), [(60.0, True), (45.0, False)])
def test_depth_of_another_lens_is_not_taken_for_registered(focal: float, *, used: bool) -> None:
    """A depth camera's own image, as wide in pixels as colour but not in degrees, bent the map."""
    calibration = camera_info_at(1, frame_id="depth_optical")
    k = calibration.intrinsics.copy()
    k[[0, 1], [0, 1]] = focal
    entries = with_mount(drive())
    entries += [
        ("/color/image_raw", image_at(1, "rgb8"), 1),
        ("/depth/image_rect_raw", image_at(1, "16UC1", frame_id="depth_optical"), 1),
        ("/color/camera_info", camera_info_at(1), 1),
        ("/depth/camera_info", replace(calibration, intrinsics=k), 1),
    ]
    plan = plan_of(entries)
    assert (plan.camera is not None) == used
    assert any("is not registered to /color/image_raw" in s for s in plan.losses) == (not used)


@pytest.mark.parametrize(("metres", "lost"), [(2.0, False), (2000.0, True)])
def test_millimetres_recorded_as_metres_are_a_loss(metres: float, *, lost: bool) -> None:
    """The map had neither grid nor points, with exit code 0."""
    deep = replace(image_at(1, "32FC1"), pixels=lambda: np.full((48, 64), metres, np.float32))
    entries = with_mount(drive())
    entries += [
        ("/color/image_raw", image_at(1, "rgb8"), 1),
        ("/depth/image_raw", deep, 1),
        ("/color/camera_info", camera_info_at(1), 1),
    ]
    losses = "\n".join(plan_of(entries).losses)
    assert ("/depth/image_raw measures 2000 m in the median" in losses) == lost

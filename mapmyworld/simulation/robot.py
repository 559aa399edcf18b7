"""The robot's body: where everything is mounted, as transforms and as URDF."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import roll_pitch_yaw_to_rotation, rotation_to_roll_pitch_yaw
from mapmyworld.simulation.robot_settings import SimulationSettings

BASE, ODOM, CHASSIS = "robot_footprint", "odom", "chassis"
LASER, CAMERA, OPTICAL = "hokuyo", "camera", "camera_link_optical"
LEFT_WHEEL, RIGHT_WHEEL = "left_wheel", "right_wheel"


def base_from_chassis(settings: SimulationSettings) -> Array:
    """Pose (4, 4) of the chassis' centre."""
    body = settings.body
    return make_transform(np.eye(3), [0.0, 0.0, body.ground_clearance + body.height / 2.0])


def chassis_from_laser(settings: SimulationSettings) -> Array:
    """Pose (4, 4) of the laser."""
    return make_transform(np.eye(3), [settings.laser.mount_x, 0.0, settings.laser.mount_z])


def chassis_from_camera(settings: SimulationSettings) -> Array:
    """Pose (4, 4) of the camera's body, x forward."""
    pitch = np.radians(settings.camera.mount_pitch)
    place = [settings.camera.mount_x, 0.0, settings.camera.mount_z]
    return make_transform(roll_pitch_yaw_to_rotation(0.0, pitch, 0.0), place)


def camera_from_optical() -> Array:
    """(4, 4) of optical axes (z forward, x right, y down) in a frame with x forward and z up."""
    rotation = roll_pitch_yaw_to_rotation(-np.pi / 2.0, 0.0, -np.pi / 2.0)
    return make_transform(np.round(rotation), [0.0, 0.0, 0.0])


def base_from_optical(settings: SimulationSettings) -> Array:
    """Pose (4, 4) of the camera's optical frame."""
    mount = base_from_chassis(settings) @ chassis_from_camera(settings)
    return np.asarray(mount @ camera_from_optical())


def base_from_laser(settings: SimulationSettings) -> Array:
    """Pose (4, 4) of the laser on the base."""
    return np.asarray(base_from_chassis(settings) @ chassis_from_laser(settings))


def chassis_from_wheel(settings: SimulationSettings, side: str, angle: float = 0.0) -> Array:
    """(4, 4) of a wheel's frame, turned about its axle by `angle` radians."""
    body = settings.body
    y = body.wheel_track / 2.0 * (1.0 if side == LEFT_WHEEL else -1.0)
    z = body.wheel_radius - body.ground_clearance - body.height / 2.0
    return make_transform(roll_pitch_yaw_to_rotation(0.0, angle, 0.0), [0.0, y, z])


def static_transforms(settings: SimulationSettings) -> tuple[tuple[str, str, Array], ...]:
    """Parent, child and `parent_from_child` (4, 4) of everything that does not move on it."""
    parts = [(BASE, CHASSIS, base_from_chassis(settings))]
    if settings.laser.enabled:
        parts.append((CHASSIS, LASER, chassis_from_laser(settings)))
    if settings.camera.enabled:
        parts.append((CHASSIS, CAMERA, chassis_from_camera(settings)))
        parts.append((CAMERA, OPTICAL, camera_from_optical()))
    return tuple(parts)


def intrinsics(settings: SimulationSettings) -> Array:
    """(3, 3) of the camera, square pixels, centre of the image on the axis."""
    camera = settings.camera
    focal = camera.width / 2.0 / np.tan(np.radians(camera.field_of_view) / 2.0)
    return np.array(
        [
            [focal, 0.0, (camera.width - 1) / 2.0],
            [0.0, focal, (camera.height - 1) / 2.0],
            [0.0, 0.0, 1.0],
        ]
    )


def urdf(settings: SimulationSettings) -> str:
    """The robot as URDF text, with the same frames as in the transforms."""
    body = settings.body
    wheel = f'<cylinder radius="{body.wheel_radius}" length="0.04"/>'
    shapes = {
        BASE: "",
        CHASSIS: f'<box size="{body.length} {body.width} {body.height}"/>',
        LASER: '<cylinder radius="0.03" length="0.07"/>',
        CAMERA: '<box size="0.03 0.10 0.03"/>',
        OPTICAL: "",
        LEFT_WHEEL: wheel,
        RIGHT_WHEEL: wheel,
    }
    joints = [*static_transforms(settings)]
    joints += [(CHASSIS, w, chassis_from_wheel(settings, w)) for w in (LEFT_WHEEL, RIGHT_WHEEL)]
    links = [BASE, *[child for _, child, _ in joints]]
    parts = [_link(name, shapes[name]) for name in links]
    parts += [_joint(parent, child, pose) for parent, child, pose in joints]
    body_text = "\n".join(parts)
    return f'<?xml version="1.0"?>\n<robot name="graph_slam_bot">\n{body_text}\n</robot>\n'


def _link(name: str, shape: str) -> str:
    if not shape:
        return f'  <link name="{name}"/>'
    upright = ' <origin xyz="0 0 0" rpy="1.570796 0 0"/>' if name.endswith("wheel") else ""
    visual = f"<visual>{upright}<geometry>{shape}</geometry></visual>"
    return f'  <link name="{name}">{visual}</link>'


def _joint(parent: str, child: str, parent_from_child: Array) -> str:
    rolling = child in {LEFT_WHEEL, RIGHT_WHEEL}
    kind = "continuous" if rolling else "fixed"
    axis = '<axis xyz="0 1 0"/>' if rolling else ""
    xyz = " ".join(f"{value:g}" for value in parent_from_child[:3, 3])
    angles = rotation_to_roll_pitch_yaw(parent_from_child[:3, :3])
    rpy = " ".join(f"{value:.6f}" for value in angles)
    return (
        f'  <joint name="{child}_joint" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/>{axis}</joint>'
    )

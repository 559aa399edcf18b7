"""Laws of rigid motions."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapmyworld.geometry import planar, rigid, rotations

tangents = arrays(np.float64, (4, 6), elements=st.floats(-1.5, 1.5))
planar_motions = arrays(np.float64, (4, 3), elements=st.floats(-10, 10))


@given(tangents)
def test_logarithm_undoes_exponential(tangent: np.ndarray) -> None:
    motion = rigid.se3_exp(tangent)
    assert rigid.se3_exp(rigid.se3_log(motion)) == pytest.approx(motion, abs=1e-9)


@given(tangents)
def test_exponential_and_adjoint_agree_with_gtsam(tangent: np.ndarray) -> None:
    theirs = gtsam.Pose3.Expmap(tangent[0])
    ours = rigid.se3_exp(tangent[0])
    assert ours == pytest.approx(theirs.matrix(), abs=1e-9)
    assert rigid.se3_adjoint(ours) == pytest.approx(theirs.AdjointMap(), abs=1e-9)


@given(tangents)
def test_a_motion_times_its_inverse_is_nothing(tangent: np.ndarray) -> None:
    motion = rigid.se3_exp(tangent)
    assert motion @ rigid.invert(motion) == pytest.approx(np.broadcast_to(np.eye(4), (4, 4, 4)))


@given(planar_motions, planar_motions)
def test_planar_motions_are_matrices_in_disguise(a: np.ndarray, b: np.ndarray) -> None:
    composed = planar.compose_planar(a, b)
    matrices = planar.planar_to_matrix(a) @ planar.planar_to_matrix(b)
    assert planar.planar_to_matrix(composed) == pytest.approx(matrices, abs=1e-9)
    back = planar.compose_planar(a, planar.between_planar(a, b))
    assert planar.planar_to_matrix(back) == pytest.approx(planar.planar_to_matrix(b), abs=1e-9)


@given(tangents)
def test_quaternions_and_rotations_are_one_thing(tangent: np.ndarray) -> None:
    rotation = rotations.so3_exp(tangent[:, :3])
    quaternion = rotations.rotation_to_quaternion(rotation)
    assert rotations.quaternion_to_rotation(quaternion) == pytest.approx(rotation, abs=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, np.pi - 1e-6, np.pi])
def test_logarithm_survives_no_turn_and_half_a_turn(angle: float) -> None:
    rotation = rotations.so3_exp(np.array([0.0, 0.0, angle]))
    assert np.linalg.norm(rotations.so3_log(rotation)) == pytest.approx(angle, abs=1e-9)


def test_interpolation_ends_where_it_should_and_turns_evenly() -> None:
    a, b = np.eye(4), rigid.se3_exp(np.array([0.0, 0.0, 1.0, 2.0, 0.0, 0.0]))
    assert rigid.interpolate(a, b, 0.0) == pytest.approx(a)
    assert rigid.interpolate(a, b, 1.0) == pytest.approx(b)
    middle = rigid.interpolate(a, b, 0.25)
    assert float(rotations.rotation_angle(middle)) == pytest.approx(0.25)
    assert middle[:3, 3] == pytest.approx(0.25 * b[:3, 3])


def test_information_of_the_plane_survives_the_way_to_space_and_back() -> None:
    information = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 0.2], [0.5, 0.2, 25.0]])
    full = planar.information_from_planar(information)
    assert planar.information_to_planar(full) == pytest.approx(information)
    assert full[5, 5] == pytest.approx(1e6)


def test_angles_wrap_into_the_half_open_turn() -> None:
    assert planar.wrap_angle([np.pi, -np.pi, 3 * np.pi]) == pytest.approx([np.pi] * 3)


@given(planar_motions, planar_motions)
def test_one_planar_motion_composes_as_many_do(a: np.ndarray, b: np.ndarray) -> None:
    many = planar.compose_planar(a, b)
    one = np.stack([planar.compose_planar(x, y) for x, y in zip(a, b, strict=True)])
    assert one == pytest.approx(many, abs=1e-12)
    inverse = np.stack([planar.invert_planar(x) for x in a])
    assert inverse == pytest.approx(planar.invert_planar(a), abs=1e-12)


@given(tangents)
def test_the_angle_is_the_length_of_the_rotation_vector(tangent: np.ndarray) -> None:
    motion = rigid.se3_exp(tangent)
    length = np.linalg.norm(rotations.so3_log(motion[:, :3, :3]), axis=-1)
    assert rotations.rotation_angle(motion) == pytest.approx(length, abs=1e-7)

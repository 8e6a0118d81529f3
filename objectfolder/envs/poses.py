"""Poses of objects, (7,) position and quaternion (w, x, y, z), and of the gripper, (4,) x, y, z, yaw."""

import mujoco
import numpy as np


def hand_axes(hands: np.ndarray) -> np.ndarray:
    """Return the axes of the gripper at (N, 4) poses, as columns: closing, lateral, up; (N, 3, 3)."""
    yaw = np.asarray(hands)[:, 3]
    cos, sin, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    return np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], 1).reshape(-1, 3, 3)


def relative_hands(hands: np.ndarray, objects: np.ndarray) -> np.ndarray:
    """Return hands (N, 4) in the frames of objects (N, 3) x, y, yaw; (N, 4)."""
    cos, sin = np.cos(objects[:, 2]), np.sin(objects[:, 2])
    x, y = (hands[:, :2] - objects[:, :2]).T
    return np.stack([cos * x + sin * y, cos * y - sin * x, hands[:, 2], hands[:, 3] - objects[:, 2]], 1)


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, np.float64))
    return matrix.reshape(3, 3)


def turn_poses(poses: np.ndarray, yaws: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Rotate poses (N, 7) by yaws (N,) about the vertical through the origin, then shift them by (N, 2)."""
    yaws = np.asarray(yaws, np.float64)
    cos, sin = np.cos(yaws), np.sin(yaws)
    x, y, z = poses[:, :3].T
    moved = np.stack([cos * x - sin * y, sin * x + cos * y, z], 1)
    moved[:, :2] += shifts
    half = np.stack([np.cos(yaws / 2), 0 * yaws, 0 * yaws, np.sin(yaws / 2)], 1)
    quaternions = np.empty((len(poses), 4))
    for out, turn, pose in zip(quaternions, half, poses):
        mujoco.mju_mulQuat(out, turn, pose[3:])
    return np.c_[moved, quaternions]

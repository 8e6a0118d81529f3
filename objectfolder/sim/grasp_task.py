"""Episodes of grasping one object by touch, many at a time (supplementary I.4)."""

from collections.abc import Callable

import numpy as np

from objectfolder.base.seeding import numpy_generator
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import Hulls, RigidBody, as_rigid_body, rotation, turn_poses
from objectfolder.sim.features import TouchBank, TouchFeatures
from objectfolder.sim.fingers import FirstContact, first_contact, require_pads
from objectfolder.sim.grasp_scene import GraspScene, check_width, lowest_hand
from objectfolder.sim.gripper import relative_hands

STEPS = 2  #: per episode
FORCE = 15.0  #: of each jaw, N
#: Range of an object's start relative to the hand: along its short side, m; along its long side, as a
#: fraction of it; yaw, rad.
START = (0.02, 0.4, 0.75)
#: Motion of the hand by an action of 1: across and along, m; up, m; yaw, rad.
ACTION_SCALE = np.array([0.012, 0.025, 0.008, 0.35])
START_HEIGHT = 0.5  #: hands start below this fraction of the object's height, where they can
DROPS = 12  #: of the object, to find its lowest resting pose
BANK_BATCH = 64  #: presses queried at once


class GraspTask:
    """Physics and touches of an object on the table, for any number of episodes at a time.

    All quantities are relative: results do not depend on where on the table the object lies, nor on the
    number of threads. Raises ObjectFolderError if the object does not fit the gripper, or the file lacks
    touch.
    """

    def __init__(self, file: ObjectFile, body: RigidBody, threads: int = 1):
        require_pads(file)
        self.file, self.scene = file, GraspScene(body, threads=threads)
        self.rest = _lowest_rest(self.scene, numpy_generator(0, file.key, "rests"))
        points = body.points @ rotation(self.rest[3:]).T
        self.size = np.ptp(points, axis=0)  #: extent of the object at rest, m

    def start(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw poses of objects, (N, 3) x, y, yaw, and of hands, (N, 4) x, y, z, yaw."""
        spread = np.array([START[0], START[1] * self.size[1], START[2]])
        objects = rng.uniform(-spread, spread, (count, 3))
        hands, low = np.zeros((count, 4)), lowest_hand()
        hands[:, 2] = rng.uniform(low, max(START_HEIGHT * self.size[2], low + 0.005), count)
        return objects, hands

    def move(self, hands: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Return the poses of hands after actions (N, 4) in [-1, 1]."""
        hands = hands + ACTION_SCALE * np.clip(actions, -1, 1)
        hands[:, 2] = np.clip(hands[:, 2], lowest_hand(), lowest_hand() + 2 * self.size[2])
        return hands

    def touch(self, objects: np.ndarray, hands: np.ndarray) -> FirstContact:
        """Return the first contacts of gently closing jaws; objects (N, 3), hands (N, 4)."""
        return first_contact(self.file, self.rest, relative_hands(hands, objects))

    def grasp(self, objects: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Simulate grasps and return whether they succeed; (N,) bool."""
        hands = relative_hands(hands, objects)
        rests = np.tile(self.rest, (len(hands), 1))
        free = np.flatnonzero(self.scene.free(rests, hands))
        success = np.zeros(len(hands), bool)
        success[free] = self.scene.grasp(rests[free], hands[free], np.full(len(free), FORCE)).success
        return success

    def free(self, objects: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Return whether the open gripper can come down there; (N,) bool."""
        return self.scene.free(np.tile(self.rest, (len(hands), 1)), relative_hands(hands, objects))

    def place_object(self, place: np.ndarray) -> np.ndarray:
        """Return the pose (7,) of an object at ``place``: x, y, yaw."""
        x, y, yaw = place
        return turn_poses(self.rest[None], np.array([yaw]), np.array([[x, y]]))[0]

    def bank(
        self, count: int, seed: int, report: Callable[[int, int], None] = lambda done, total: None
    ) -> TouchBank:
        """Compute features of presses at ``count`` poses that episodes can reach."""
        rng = numpy_generator(seed, self.file.key, "bank")
        objects, hands = self.start(count, rng)
        for _ in range(STEPS):
            hands = self.move(hands, rng.uniform(-1, 1, (count, 4)) * rng.integers(0, 2, (count, 1)))
        touch = self.touch(objects, hands)
        pressed = touch.presses.take(np.flatnonzero(touch.touched.ravel()))
        total, features, query = len(pressed.points), [], TouchFeatures(self.file)
        for rows in np.split(np.arange(total), range(BANK_BATCH, total, BANK_BATCH)):
            features.append(query(pressed.take(rows)))
            report(min(len(features) * BANK_BATCH, total), total)
        return TouchBank(pressed, np.concatenate(features))


def make_task(file: ObjectFile, hulls: Hulls = None) -> GraspTask:
    """Make the task of an Object File; hulls are those of `objectfolder.sim.body.as_rigid_body`.

    Raises ObjectFolderError as `GraspTask` and as that function; objects that do not fit are refused before
    hulls are computed.
    """
    require_pads(file)
    check_width(file.key, file.surface.vertices * file.scale)
    return GraspTask(file, as_rigid_body(file, hulls))


def _lowest_rest(scene: GraspScene, rng: np.random.Generator) -> np.ndarray:
    """Return the resting pose with the lowest centre of mass, its longer side along y; (7,)."""
    rests = scene.rests(rng, DROPS)
    heights = [(rotation(pose[3:]) @ scene.body.centre + pose[:3])[2] for pose in rests]
    pose = rests[int(np.argmin(np.round(heights, 4)))]
    points = scene.body.points @ rotation(pose[3:]).T
    yaws = np.linspace(0, np.pi, 180, endpoint=False)
    extents = np.ptp(points[:, 0, None] * np.cos(yaws) - points[:, 1, None] * np.sin(yaws), axis=0)
    return turn_poses(pose[None], yaws[[int(extents.argmin())]], np.zeros((1, 2)))[0]

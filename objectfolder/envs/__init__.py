"""Rigid bodies for physics engines, and Gymnasium environments for robots.

``gymnasium.make("objectfolder.envs:ObjectFolder/Reach-v0", file="build/mug/ObjectFile.safetensors")``
"""

from objectfolder.errors import ObjectFolderError

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise ObjectFolderError(
        f"{error.name} is not installed; this needs: pip install 'objectfolder[rl]'"
    ) from error

gymnasium.register(
    id="ObjectFolder/Grasp-v0",
    entry_point="objectfolder.envs.grasp:GraspEnv",
    vector_entry_point="objectfolder.envs.grasp:GraspVectorEnv",
)
gymnasium.register(id="ObjectFolder/Reach-v0", entry_point="objectfolder.envs.reach:ReachEnv")

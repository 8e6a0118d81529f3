"""Rigid bodies for physics engines, and Gymnasium environments for robots.

``gymnasium.make("objectfolder.sim:ObjectFolder/Reach-v0", file="build/mug/ObjectFile.safetensors")``
"""

from contextlib import suppress

with suppress(ModuleNotFoundError):  # rigid bodies and hulls do without it
    import gymnasium

    gymnasium.register(
        id="ObjectFolder/Grasp-v0",
        entry_point="objectfolder.sim.grasp:GraspEnv",
        vector_entry_point="objectfolder.sim.grasp:GraspVectorEnv",
    )
    gymnasium.register(id="ObjectFolder/Reach-v0", entry_point="objectfolder.sim.reach:ReachEnv")
    gymnasium.register(id="ObjectFolder/Drop-v0", entry_point="objectfolder.sim.drop:DropEnv")
    gymnasium.register(id="ObjectFolder/Tap-v0", entry_point="objectfolder.sim.tap:TapEnv")
    gymnasium.register(
        id="ObjectFolder/Explore-v0",
        entry_point="objectfolder.sim.explore:ExploreEnv",
        vector_entry_point="objectfolder.sim.explore_batch:ExploreVectorEnv",
    )
    gymnasium.register(id="ObjectFolder/Slide-v0", entry_point="objectfolder.sim.slide:SlideEnv")

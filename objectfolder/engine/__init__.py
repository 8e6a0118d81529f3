"""Parallel build over DVC's own graph; `objectfolder.engine.build.build` is the entry."""

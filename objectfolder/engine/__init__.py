"""Parallel build over DVC's own graph; `objectfolder.engine.local.build` is the entry."""

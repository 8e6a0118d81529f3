from own_workspace import workspace  # noqa: F401

from own_workspace import workspace  # noqa: F401
from publisher import publisher  # noqa: F401

"""Where a JSON value can be damaged."""

from typing import Any


def leaves(value: Any) -> list[tuple[Any, Any]]:
    """Return containers and keys of all values within one."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [leaf for key, item in items for leaf in [(value, key), *leaves(item)]]

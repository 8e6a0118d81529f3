"""Standard output of all commands."""

from rich.console import Console

console = Console()

"""What folders hold."""


def contents(folder) -> dict[str, bytes]:
    """Contents of the files in a folder and in those below, by path."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

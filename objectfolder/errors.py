"""The exception that the command line shows without a traceback."""


class ObjectFolderError(ValueError):
    """An error that the user can fix.

    The message names the object or file, the offending value, what was expected and what to do next.
    """


def shortened(value: object, most: int = 60) -> str:
    """Return a value's text for a message; of a long one, its beginning and its end."""
    text = str(value)
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"

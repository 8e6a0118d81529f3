"""The exception that the command line shows without a traceback."""


class ObjectFolderError(ValueError):
    """An error that the user can fix.

    The message names the object or file, the offending value, what was expected and what to do next.
    """

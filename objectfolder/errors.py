"""The one exception that the command line shows without a traceback."""


class ObjectFolderError(ValueError):
    """Something that the user can put right.

    The message names the object or file, the offending value, what was expected and what to do next.
    """

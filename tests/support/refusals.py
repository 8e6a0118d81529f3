"""What the package refuses."""

import pytest

from objectfolder.base.errors import ObjectFolderError


def refused(message, ask, /, *arguments, **options) -> str:
    """Check that a call raises ObjectFolderError; return its message, which matches a given one."""
    with pytest.raises(ObjectFolderError, match=message) as error:
        ask(*arguments, **options)
    return str(error.value)

"""What is refused, and in which words."""

import pytest

from objectfolder.base.errors import ObjectFolderError


def refused(words: str):
    """Expect an ObjectFolderError whose text matches a regular expression."""
    return pytest.raises(ObjectFolderError, match=words)

"""hash_code: source files, materials -> for each stage, the digests of the modules that it imports.

Each other stage depends on its list instead of some fifty modules: editing a module reruns exactly the
stages that import it, and dvc.lock stays small. `modal` depends on the digest of its object's material as
well. In a workspace without the package, stages depend on digests of the package's other files, too.
"""

import sys
from pathlib import Path

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_text
from objectfolder.workspace.code_digests import code_text, data_names
from objectfolder.workspace.installed import check_installed, is_recorded
from objectfolder.workspace.layout import MATERIALS, code_list
from objectfolder.workspace.params import read


def main() -> None:
    check_installed()
    stages = {script.stem for script in Path("stages").glob("*.py")} - {"__init__", "hash_code"}
    materials = [f"{MATERIALS}/{key}" for key in read()["objects"]]
    for name in [*sorted(stages), *materials, *(data_names() if is_recorded() else ())]:
        write_text(code_list(name), code_text(name) or "")


if __name__ == "__main__":
    try:
        main()
    except ObjectFolderError as error:
        sys.exit(f"hash_code: {error}")

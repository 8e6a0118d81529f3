"""hash_code: source files -> for each stage, the digests of the modules that it imports.

The other stages depend on their list, not on fifty modules each: editing a module reruns the stages that
import it and no others, and dvc.lock stays small.
"""

from pathlib import Path

from objectfolder.io import write_text
from objectfolder.workspace.code_digests import digests
from objectfolder.workspace.layout import code_list


def main() -> None:
    for script in sorted(Path("stages").glob("*.py")):
        if script.name not in ("__init__.py", "hash_code.py"):
            write_text(code_list(script.stem), digests(script))


if __name__ == "__main__":
    main()

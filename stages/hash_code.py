"""hash_code: source files -> for each stage, the digests of the modules that it imports.

Each other stage depends on its list instead of some fifty modules: editing a module reruns exactly the stages
that import it, and dvc.lock stays small.
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

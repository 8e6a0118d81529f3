"""Add objects to ``params.yaml``: comments and order are kept, and a failure changes nothing."""

import os
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from ruamel.yaml.comments import CommentedMap

from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_text
from objectfolder.base.materials import own_material
from objectfolder.base.yamlfile import is_yaml_name
from objectfolder.mesh.reading.load import default_up, load_mesh, references
from objectfolder.mesh.settings import NormalizeConfig
from objectfolder.workspace import params
from objectfolder.workspace.check import check_object
from objectfolder.workspace.document import edited
from objectfolder.workspace.layout import MATERIALS
from objectfolder.workspace.stages import check_key

MIN_SCALE, MAX_SCALE = 0.001, 20  # metres; beyond, the unit is probably wrong


def add_mesh(
    mesh: Path,
    key: str,
    material: str,
    scale: float | None,
    up: str | None,
    root: Path = Path(),
    attachments: Sequence[Path] = (),
    wall: float | None = None,
    bridge: str = "all",
    examined: bool = False,
    mass: float | None = None,
    *,
    track: Callable[[Path, Path], None],
) -> dict[str, Any]:
    """Copy a mesh into the workspace, track it with DVC and enter it in ``params.yaml``.

    Parameters
    ----------
    mesh : Path
        In one of `objectfolder.mesh.reading.load.FORMATS`; files that it refers to are copied too.
    key : str
        Object key.
    material : str
        A name, or a material's file, which is copied to ``materials/`` unless it lies there.
    scale : float or None
        Longest side, metres; None: the longest side of the mesh, whose unit is then metres.
    up : {"y", "z"} or None
        None: the default of the format.
    attachments : sequence of Path
        Further files to keep beside the mesh, such as a licence.
    wall : float, optional
        Thickness that open sheets get, metres.
    bridge : {"all", "fem", "off"}
        Where to fill small gaps.
    examined : bool
        Whether the mesh is known to load; it is not loaded again if its scale is given too.
    mass : float, optional
        Of the real object, kg; default: that of the solid, filled with the material.
    track : callable
        Puts a folder of a workspace under version control, with all its files, or raises; takes both paths.

    Returns
    -------
    dict
        The new entry.

    Raises
    ------
    ObjectFolderError
        If an argument or the mesh is invalid, or it refers to a file whose name is reserved or given to
        another; nothing is changed then.
    """
    params_path = root / params.PARAMS_FILE
    values = params.read(params_path)
    home = check_new(key, values, root, mesh)
    up = up or default_up(mesh)
    size = scale
    if size is None or not examined:
        most = params.settings(NormalizeConfig, values, params_path).texture_size
        lower, upper = load_mesh(mesh, up, most).bounds
        size = float(f"{(upper - lower).max():.6g}") if size is None else size
    if not MIN_SCALE <= size <= MAX_SCALE:
        raise ObjectFolderError(
            f"scale of {key} is {size:g} m, expected the longest side in metres, {MIN_SCALE} to {MAX_SCALE}; "
            + ("the mesh is in other units: give --scale" if scale is None else "give it in metres")
        )
    named, own = _place_material(material, root)
    entry = {
        "mesh": f"data/objects/{key}/mesh{mesh.suffix.lower()}",
        "material": named,
        "scale": size,
        "up": up,
        "wall": wall,
        "bridge": bridge,
        "mass": mass,
    }
    sources = object_files(mesh, attachments)
    placed = False
    try:
        if own:
            write_text(root / named, own)
        entry = check_object(key, {"objects": {key: entry}}, params_path).model_dump()
        needed = sum(source.stat().st_size for source in sources.values())
        with new_folder(f"{key}: mesh", home, needed, "") as staging:
            for target, source in sources.items():
                copy = staging / target
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, copy)
        placed = True
        track(home, root)
        with edited(params_path) as (document, _):  # read now: others may have edited it in the meantime
            document["objects"][key] = _one_line(entry)
    except BaseException as error:
        if placed:
            shutil.rmtree(home, ignore_errors=True)
            home.with_name(f"{key}.dvc").unlink(missing_ok=True)
        if own:
            (root / named).unlink(missing_ok=True)
        if isinstance(error, OSError) or (isinstance(error, ObjectFolderError) and not placed):
            raise ObjectFolderError(f"cannot add {key} to {home}: {error}; nothing was changed") from error
        raise
    return entry


def _place_material(given: str, root: Path) -> tuple[str, str]:
    """Return what names a material in ``params.yaml``, and the text of a file to write there, if any.

    Raises ObjectFolderError if the file is no material's, or ``materials/`` has another of its name.
    """
    if not is_yaml_name(given):
        return given, ""
    own_material(given)
    source, target = Path(given), root / MATERIALS / Path(given).name
    text, named = source.read_text(encoding="utf-8"), f"{MATERIALS}/{source.name}"
    if not target.is_file():
        return named, text
    if target.read_text(encoding="utf-8") != text:
        raise ObjectFolderError(f"{target} is another material than {given}; rename one")
    return named, ""


def set_material(key: str, described: dict[str, Any], root: Path = Path()) -> None:
    """Give an object of a workspace a material of its own; see `objectfolder.base.materials.own_material`."""
    path = root / params.PARAMS_FILE
    with edited(path) as (document, _):
        document["objects"][key]["material"] = _one_line(described)


def object_files(mesh: Path, attachments: Sequence[Path] = ()) -> dict[PurePosixPath, Path]:
    """Map the files of an object's folder, the mesh first, to those that they are copied from.

    Raises ObjectFolderError if a file is missing, or has a name that is reserved or given to another.
    """
    sources: dict[PurePosixPath, Path] = {}
    folded: dict[str, Path] = {}
    # Those of a neighbouring folder go beside the mesh, where its reader looks for them as well.
    wanted = [
        (mesh.parent / name, PurePosixPath(name.name) if ".." in name.parts else name)
        for name in references(mesh)
    ]
    for source, target in (
        (mesh, PurePosixPath("mesh" + mesh.suffix.lower())),
        *((path, PurePosixPath(path.name)) for path in attachments),
        # Only faces need a texture, and the reader of the mesh raises for one that is missing.
        *(pair for pair in wanted if pair[0].is_file()),
    ):
        if not source.is_file():
            raise ObjectFolderError(f"{mesh} refers to {source}, which does not exist; put it there")
        if any(map(_reserved, target.parts)):
            raise ObjectFolderError(
                f"{mesh} refers to {target}, a name that is reserved for Git, DVC and hidden files; rename it"
            )
        # Without regard to case, as some file systems compare names.
        name = str(target).casefold()
        if not folded.setdefault(name, source).samefile(source):
            raise ObjectFolderError(
                f"{mesh} refers to {target}, a name that {folded[name]} gets in the workspace; rename it"
            )
        sources[target] = source
    for target in sources:
        if any(str(folder).casefold() in folded for folder in target.parents):
            raise ObjectFolderError(
                f"{mesh} refers to {target}, in a folder that has the name of a file; rename the folder"
            )
    return sources


def _reserved(name: str) -> bool:
    name = name.casefold()
    return name.startswith(".") or name.endswith(".dvc") or name in ("dvc.yaml", "dvc.lock")


def check_new(key: str, values: dict[str, Any], root: Path = Path(), mesh: Path | None = None) -> Path:
    """Return the folder for the files of a new object, of a mesh that lies elsewhere.

    Raises ObjectFolderError if the key is not valid, or taken.
    """
    check_key(key)
    home = root / "data" / "objects" / key
    record = home.with_name(f"{key}.dvc")
    entries = [f"{group}.{key}" for group in ("objects", "procedural") if key in values[group]]
    remedies = [f"delete {' and '.join(entries)} from {root / params.PARAMS_FILE}"] if entries else []
    if os.path.lexists(record):
        remedies.append(f"run `dvc remove --outs {record}`")
    elif mesh is not None and home.resolve() in mesh.resolve().parents:
        raise ObjectFolderError(
            f"{mesh} lies in {home}, where its copy will be; move it out of {home.parent} and "
            "add it from there"
        )
    elif os.path.lexists(home):
        remedies.append(f"delete the folder {home}")
    if remedies:
        raise ObjectFolderError(
            f"object {key!r} exists already; choose another name, or remove it: {', then '.join(remedies)}"
        )
    return home


def add_catalogue(catalogue: Path, root: Path = Path()) -> list[str]:
    """Enter a catalogue's procedural objects and object entries in ``params.yaml``; return the keys added.

    Identical entries that exist already are skipped. Raises ObjectFolderError if there is no such catalogue,
    an entry is invalid, or another one has its key; if the mesh of a new object is neither there nor
    procedural; or if there are files where a new procedural object's will be.
    """
    params_path = root / params.PARAMS_FILE
    if not catalogue.is_file():
        problem = "is a folder" if catalogue.is_dir() else "does not exist"
        raise ObjectFolderError(f"{catalogue} {problem}; expected a catalogue such as catalogs/starter.yaml")
    if re.search(r"^(sources|extends):", catalogue.read_text(errors="replace"), re.MULTILINE):
        raise ObjectFolderError(
            f"{catalogue} lists published objects whose meshes are not here; download them with "
            f"`objectfolder fetch --catalogue {catalogue}`"
        )
    new = params.read(catalogue)
    # Write every field: DVC tracks them one by one and does not see missing ones.
    for key in new["objects"]:
        new["objects"][key] = check_object(key, new, catalogue).model_dump()
    added = []
    with edited(params_path) as (document, values):
        for group in ("procedural", "objects"):
            for key, entry in new[group].items():
                present = values[group].get(key)
                if present is None:
                    if group == "procedural":
                        _check_place(key, catalogue, root)
                    elif key not in {**values["procedural"], **new["procedural"]}:
                        _check_mesh(key, entry["mesh"], catalogue, root)
                    document[group][key] = _one_line(entry)
                    added += [key] if group == "objects" else []
                elif {"mass": None, **present} != {"mass": None, **entry}:
                    raise ObjectFolderError(
                        f"{catalogue}: {group}.{key} differs from the one in {params_path}; rename or remove "
                        "one"
                    )
    return added


def _check_mesh(key: str, mesh: str, catalogue: Path, root: Path) -> None:
    if not (root / mesh).is_file() and not (root / "data" / "objects" / f"{key}.dvc").is_file():
        raise ObjectFolderError(
            f"{catalogue}: objects.{key}: its mesh {root / mesh} does not exist, and the catalogue has no "
            f"procedural.{key}; copy the mesh there first, or add it with `objectfolder add MESH`"
        )


def _check_place(key: str, catalogue: Path, root: Path) -> None:
    """Check that nothing is where ``generate`` will write: DVC removes what a stage's output replaces."""
    record = root / "data" / "objects" / f"{key}.dvc"
    if record.exists():
        raise ObjectFolderError(
            f"{catalogue}: procedural.{key} would be written to {record.with_suffix('')}, whose files "
            f"{record} tracks, expected none; run `dvc remove --outs {record}` if they are obsolete, or "
            "choose another name"
        )
    home, lock = record.with_suffix(""), root / "dvc.lock"
    if home.is_dir() and any(home.iterdir()):
        if lock.is_file() and re.search(rf"^  generate@{key}:", lock.read_text(), re.MULTILINE):
            return  # of an earlier build
        raise ObjectFolderError(
            f"{catalogue}: procedural.{key} would replace the files in {home}, which no build wrote; move "
            "them away, or choose another name"
        )


def _one_line(entry: dict[str, Any]) -> CommentedMap:
    line = CommentedMap(entry)
    line.fa.set_flow_style()
    return line

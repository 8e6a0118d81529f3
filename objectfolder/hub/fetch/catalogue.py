"""Catalogues of published objects and the sources of their meshes."""

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Literal
from urllib.parse import quote, urlsplit

from pydantic import Field, ValidationError, field_validator

from objectfolder.base.checks import is_web_address
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.io import existing_file
from objectfolder.base.materials import material
from objectfolder.base.yamlfile import read_yaml
from objectfolder.workspace import params
from objectfolder.workspace.stages import check_key


class MeshSource(params.Record):
    """A collection of meshes; ``{model}`` in a URL stands for the object's id there."""

    title: str
    page: str  #: web page
    url: str
    kind: Literal["archive", "polyhaven"]  #: zip or tar of one object; file list of the Poly Haven API
    resolution: str = "1k"  #: of the textures, if the source offers several
    mesh: str  #: end of the path of the mesh
    up: Literal["y", "z"]
    licence: str
    attribution: str
    masses: str = ""  #: where the masses of its objects are published


class Entry(params.Record):
    """One published object."""

    id: int | None = None  #: number in the paper's table, if it is there
    name: str
    material: str
    scale: float = Field(gt=0, le=100)  #: longest side, metres
    mass: float | None = Field(default=None, gt=0, le=1e6)  #: of the real object, kg
    source: str
    model: str = ""  #: id at the source, if not the name
    category: str = ""
    note: str = ""

    @field_validator("material")
    @classmethod
    def _known(cls, value: str) -> str:
        return material(value).name

    @property
    def source_model(self) -> str:
        """Id at the source."""
        return self.model or self.name


class Catalogue(params.Record):
    """Sources and objects by key."""

    version: int = 1
    sources: dict[str, MeshSource]
    objects: dict[str, Entry]

    def source(self, key: str) -> MeshSource:
        """Return the source of an object."""
        return self.sources[self.objects[key].source]

    def url(self, key: str) -> str:
        """Return the URL of an object."""
        return object_url(self.source(key).url, self.objects[key].source_model)

    def archive_name(self, key: str) -> str:
        """Return the file name in an object's URL."""
        return PurePosixPath(urlsplit(self.url(key)).path).name or key

    def page(self, key: str) -> str:
        """Return the URL of an object's web page."""
        return object_url(self.source(key).page, self.objects[key].source_model)


def object_url(template: str, model: str) -> str:
    """Insert an object's id at its source into a template."""
    return template.replace("{model}", quote(model, safe=""))


def read_catalogue(path: Path, urls: Sequence[str] = ()) -> Catalogue:
    """Read a catalogue.

    ``path``: YAML with ``sources`` and ``objects``; with ``extends``, sources and whatever its objects lack
    are those of this other catalogue in the same folder. ``urls``: ``SOURCE=TEMPLATE``: URL templates to use
    instead of those in the catalogue. Raises ObjectFolderError if one of the files is missing or invalid, an
    object has an unknown source, or a template is not a URL.
    """
    existing_file(path, "expected a catalogue of published objects, such as catalogs/objectfolder1.yaml")
    catalogue = _validated(_with_base(read_yaml(path), path), path)
    for key, entry in catalogue.objects.items():
        check_key(key, f"{path}: objects")
        if entry.source not in catalogue.sources:
            wrong, expected = f"objects.{key}.source is {quoted(entry.source)}", ", ".join(catalogue.sources)
            raise ObjectFolderError(f"{path}: {wrong}, expected one of {expected}")
    return catalogue.model_copy(update={"sources": _with_urls(catalogue.sources, urls)})


def _validated(values: Any, path: Path) -> Catalogue:
    try:
        return Catalogue.model_validate(values)
    except ValidationError as error:
        problems = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise ObjectFolderError(f"{path} is not a catalogue of published objects: {problems}") from error


def _with_base(values: Any, path: Path) -> Any:
    """Complete a catalogue's values by those of the one that it extends, which may not extend another."""
    if not isinstance(values, Mapping) or "extends" not in values:
        return values
    own = {"sources": {}, **values}
    name = own.pop("extends")
    if not isinstance(name, str) or not name or Path(name).name != name:
        raise ObjectFolderError(f"{path}: extends is {quoted(name)}, expected a file name in the same folder")
    base_path = existing_file(path.with_name(name), f"{path} extends it")
    base = _validated(read_yaml(base_path), base_path).model_dump()
    for section, kept in (("sources", base["sources"]), ("objects", {})):
        if isinstance(given := own.get(section), Mapping):
            known = base[section]
            completed = {
                key: {**known.get(key, {}), **entry} if isinstance(entry, Mapping) else entry
                for key, entry in given.items()
            }
            own[section] = kept | completed
    return own


def _with_urls(sources: Mapping[str, MeshSource], urls: Sequence[str]) -> dict[str, MeshSource]:
    changed: dict[str, Any] = {}
    for option in urls:
        name, equals, template = option.partition("=")
        if not equals or name not in sources:
            expected = f"SOURCE=TEMPLATE with SOURCE one of {', '.join(sources)}"
            raise ObjectFolderError(f"--url {option} is not {expected}")
        changed[name] = sources[name].model_copy(update={"url": template})
    for name, source in (result := {**sources, **changed}).items():
        if "{model}" not in source.url or not is_web_address(object_url(source.url, "model")):
            wrong = f"URL of source {name} is {quoted(source.url)}"
            expected = "http:// or https:// and {model} in place of the object's id"
            advice = "for files on this computer use --from DIR"
            raise ObjectFolderError(f"{wrong}, expected {expected}; {advice}")
        if not is_web_address(object_url(source.page, "model")):
            wrong = f"page of source {name} is {quoted(source.page)}"
            raise ObjectFolderError(f"{wrong}, expected an address with http:// or https://")
    return result


def comparable_name(name: str) -> str:
    """Return a name in lower case without punctuation, for comparison."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def select_objects(catalogue: Catalogue, wanted: Sequence[str]) -> list[str]:
    """Return keys of objects by key, published name or id at the source, whatever case and punctuation.

    Each is there once, in the given order. Raises ObjectFolderError, which lists similar names.
    """
    known = {
        comparable_name(name): key
        for key, entry in catalogue.objects.items()
        for name in (key, entry.name, entry.source_model)
    }
    for name in wanted:
        if comparable_name(name) not in known:
            near = [key for form, key in known.items() if comparable_name(name) in form]
            near += [known[form] for form in difflib.get_close_matches(comparable_name(name), known, 5)]
            shown = ", ".join(list(dict.fromkeys(near))[:8])
            hint = f"similar: {shown}; " if near and comparable_name(name) else ""
            raise ObjectFolderError(f"no object {name!r} in the catalogue; {hint}--list shows all of them")
    return list(dict.fromkeys(known[comparable_name(name)] for name in wanted))

"""One page that answers from Object Files in a browser, without a server."""

import base64
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

from objectfolder.base.materials import LAWS, material, material_names
from objectfolder.base.text import in_html, in_script
from objectfolder.sound.contact import load_striker
from objectfolder.touch.profiles import available_profiles, load_profile
from objectfolder.viewer.background import pack_background


def viewer_page(objects: Mapping[str, bytes], title: str = "Object File") -> str:
    """Return a page of HTML that holds Object Files, by the names in its menu, and answers from them.

    It works from disk and offline: nothing is loaded from anywhere.
    """
    return fill_page("page.html", page_parts(objects, title) | {"script": static_text("viewer.js")})


def page_parts(objects: Mapping[str, bytes], title: str) -> dict[str, str]:
    """Return what `fill_page` puts into page.html, but for the program."""
    embedded = "\n".join(_embedded(name, content) for name, content in objects.items())
    return {"title": in_html(title), "settings": _settings(), "objects": embedded}


def fill_page(name: str, parts: Mapping[str, str]) -> str:
    """Return a page that ``viewer/`` builds with parts in place of their names in braces."""
    # One pass: what is put in may hold braces itself.
    first, *rest = static_text(name).split("{{")
    return first + "".join(parts[part] + text for part, _, text in (piece.partition("}}") for piece in rest))


def viewer_frame(objects: Mapping[str, bytes], height: int = 640) -> str:
    """Return `viewer_page` in a frame, for notebooks; its height is in pixels."""
    page, style = escape(viewer_page(objects)), f"width:100%;height:{height}px;border:0"
    return f'<iframe srcdoc="{page}" sandbox="allow-scripts" style="{style}" allow="autoplay"></iframe>'


@cache
def static_text(name: str) -> str:
    """Return a file that ``viewer/`` builds (docs/viewer.md)."""
    return (files("objectfolder.viewer") / "static" / name).read_text(encoding="utf-8")


def _embedded(name: str, content: bytes) -> str:
    text = base64.b64encode(content).decode()
    return f'<script type="text/plain" data-object="{in_html(name)}">{text}</script>'


@cache
def _settings() -> str:
    """Return materials and sensors as JSON that may stand in HTML."""
    materials = {law: {name: _material(name, law) for name in material_names()} for law in LAWS}
    sensors = {name: page_sensor(name) for name in available_profiles()}
    striker = asdict(load_striker("steel"))  # which strikes by default
    return in_script({"materials": materials, "sensors": sensors, "striker": striker})


def _material(name: str, law: str) -> dict[str, Any]:
    return {"name": name, **material(name, law).properties()}


def page_sensor(name: str) -> dict[str, Any]:
    """Return a profile as the page takes it: without what only people and calibrations read."""
    unread = ("source", "noise_std", "press_depth", "background_image", "background_sha256")
    profile = load_profile(name)
    values = {key: value for key, value in profile.to_dict().items() if key not in unread}
    return values | ({"background": pack_background(profile)} if profile.background_image else {})

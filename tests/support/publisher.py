"""A local stand-in for the publishers of meshes: their archive layouts, and a server with their bad days."""

import hashlib
import io
import json
import tarfile
import threading
import zipfile
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import trimesh
from gltf_scene import Scene
from PIL import Image

from objectfolder.base import download


def texture(shade: int = 200) -> bytes:
    stream = io.BytesIO()
    # Noise, so that archives are long enough to break off in the middle.
    noise = np.random.default_rng(shade).integers(0, 255, (128, 128, 3), dtype=np.uint8)
    Image.fromarray(noise).save(stream, "png")
    return stream.getvalue()


def box_obj(library: str, sides=(0.1, 0.05, 0.117)) -> bytes:
    box = trimesh.creation.box(sides)
    lines = [f"mtllib {library}", "usemtl m"]
    lines += [f"v {x} {y} {z}" for x, y, z in box.vertices] + ["vt 0 0", "vt 1 0", "vt 1 1"]
    lines += [f"f {a}/1 {b}/2 {c}/3" for a, b, c in box.faces + 1]
    return "\n".join(lines).encode()


def tgz(members: dict[str, bytes], extra: list[tarfile.TarInfo] = ()) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        for name, content in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
        for info in extra:
            archive.addfile(info)
    return stream.getvalue()


def zipped(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def ycb(model: str, **box) -> bytes:
    """``NNN_name_google_16k.tgz``."""
    home = f"{model}/google_16k"
    members = {
        f"{model}/._google_16k": b"Mac OS X",
        f"{home}/._textured.obj": b"Mac OS X",
        f"{home}/nontextured.ply": b"not looked at",
        f"{home}/textured.obj": box_obj("./textured.mtl", **box),
        f"{home}/textured.mtl": b"newmtl m\nmap_Kd texture_map.png\n",
        f"{home}/texture_map.png": texture(),
    }
    return tgz(members)


def gso() -> bytes:
    """``NAME.zip`` of Gazebo Fuel."""
    members = {
        **{"model.config": b"<model/>", "model.sdf": b"<sdf/>", "thumbnails/0.jpg": b"not looked at"},
        "meshes/model.obj": box_obj("model.mtl"),
        "meshes/model.mtl": b"newmtl m\nmap_Kd texture.png\n",
        "materials/textures/texture.png": texture(),
    }
    return zipped(members)


def polyhaven(server: "Publisher", model: str, resolution: str = "1k") -> dict[str, bytes]:
    """Pages by path: the files list of the API, and the files."""
    box = trimesh.creation.box([0.5, 0.88, 0.5])  # y up
    scene, picture = Scene(), f"textures/{model}_diff_{resolution}.png"
    image = scene.append("images", {"uri": picture})
    material = scene.material(scene.append("textures", {"source": image}))
    scene.node(scene.mesh(box.vertices, box.faces, material, TEXCOORD_0=box.vertices[:, :2]))
    files = {
        f"{model}_{resolution}.gltf": json.dumps(scene.finished(f"{model}.bin")).encode(),
        f"{model}.bin": scene.data,
        picture: texture(),
    }
    pages = {f"/dl/{resolution}/{name}": content for name, content in files.items()}
    listed = {
        name: {"url": server.url + path, "size": len(content), "md5": hashlib.md5(content).hexdigest()}
        for name, (path, content) in zip(files, pages.items())
    }
    main = listed.pop(f"{model}_{resolution}.gltf")
    listing = {"blend": {}, "gltf": {resolution: {"gltf": {**main, "include": listed}}}}
    return {**pages, f"/files/{model}": json.dumps(listing).encode()}


class Publisher:
    """Serves ``pages`` by path from a thread."""

    def __init__(self):
        publisher = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                publisher.answer(self)

            def log_message(self, *args):
                pass

        self.pages: dict[str, bytes] = {}
        self.ranges = True
        self.validators = True
        self.drops: dict[str, list[int]] = {}
        self.refusals: dict[str, list[int]] = {}
        self.scripts: dict[str, Callable[[BaseHTTPRequestHandler], None]] = {}
        self.requests: list[tuple[str, dict[str, str]]] = []
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        self.thread = threading.Thread(target=self.server.serve_forever, args=(0.01,))
        self.thread.start()

    def close(self):
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()

    def answer(self, handler):
        self.requests.append((handler.path, dict(handler.headers)))
        if script := self.scripts.get(handler.path):
            with suppress(ConnectionError):
                script(handler)
            return
        if refusals := self.refusals.get(handler.path):
            handler.send_error(refusals.pop(0))
            return
        if (content := self.pages.get(handler.path)) is None:
            handler.send_error(404)
            return
        tag = f'"{hashlib.sha256(content).hexdigest()[:12]}"'
        wanted, start = handler.headers.get("Range"), 0
        if wanted and self.ranges and handler.headers.get("If-Range", tag) == tag:
            start = int(wanted.removeprefix("bytes=").removesuffix("-"))
            if start >= len(content):
                handler.send_error(416)
                return
            handler.send_response(206)
            handler.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        else:
            handler.send_response(200)
        if self.validators:
            handler.send_header("ETag", tag)
        handler.send_header("Content-Length", str(len(content) - start))
        handler.end_headers()
        drops = self.drops.get(handler.path)
        body = content[start:]
        handler.wfile.write(body[: drops.pop(0)] if drops else body)


@pytest.fixture
def publisher(monkeypatch):
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    server = Publisher()
    yield server
    server.close()


@pytest.fixture
def no_waits(monkeypatch):
    """The waits between attempts, which are recorded instead."""
    waits = []
    monkeypatch.setattr(download.time, "sleep", waits.append)
    return waits


def addresses(publisher):
    paths = {"ycb": "{model}_google_16k.tgz", "gso": "{model}.zip", "polyhaven": "files/{model}"}
    return [f"{source}={publisher.url}/{path}" for source, path in paths.items()]

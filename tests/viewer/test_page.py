import base64
import hashlib
import json
import lzma
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile
from hostile import WORDS, Elements
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import material, material_names
from objectfolder.base.text import visible
from objectfolder.benchmarks.listening import study_page
from objectfolder.cli import app
from objectfolder.report.site import write_site
from objectfolder.sound.contact import Striker, load_striker
from objectfolder.touch.photographs import read_photograph
from objectfolder.touch.profiles import available_profiles, load_profile
from objectfolder.viewer.background import STEP
from objectfolder.viewer.page import fill_page, static_text, viewer_frame, viewer_page

VIEWER = Path(__file__).parents[2] / "viewer"
BUILT = Path(viewer_page.__code__.co_filename).parent / "static"
has_node = pytest.mark.skipif(
    shutil.which("node") is None or not (VIEWER / "node_modules").exists(),
    reason="needs node and `npm ci` in viewer/",
)


def embedded(page):
    """Object Files in a page by name."""
    found = re.findall(r'<script type="text/plain" data-object="([^"]*)">([^<]*)</script>', page)
    return {name: base64.b64decode(text) for name, text in found}


def settings(page):
    return json.loads(re.search(r'<script type="application/json" id="settings">(.*?)</script>', page)[1])


def test_a_page_holds_its_objects_and_loads_nothing():
    objects = {"mug": bytes(range(256)), "bell": b"</script>{{script}}"}
    page = viewer_page(objects, title="a </title><script>")
    assert embedded(page) == objects
    assert "<title>a &lt;/title&gt;&lt;script&gt;</title>" in page
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)
    assert page.count("<script") == page.count("</script>") == 2 + len(objects)


def test_a_page_knows_materials_and_sensors():
    found = settings(viewer_page({}))
    for law, materials in found["materials"].items():
        assert list(materials) == material_names()
        assert materials["steel"]["density"] == material("steel").density
        assert ("loss_factor" in materials["steel"]) == (law == "loss_factor")
    assert found["materials"]["loss_factor"]["wood"]["loss_factor"] == [[500, 0.01], [5000, 0.02]]
    assert list(found["sensors"]) == available_profiles()
    assert found["sensors"]["digit"]["lights"][0]["intensity"] > 0
    assert Striker(**found["striker"]) == load_striker("steel")


def test_a_page_holds_the_backgrounds_of_sensors_with_a_picture_within_two_levels():
    for name, sensor in settings(viewer_page({}))["sensors"].items():
        profile = load_profile(name)
        assert ("background" in sensor) == bool(profile.background_image)
        if profile.background_image:
            truth = read_photograph(profile.background_image, profile)
            rows = lzma.decompress(base64.b64decode(sensor["background"]))
            steps = np.cumsum(np.frombuffer(rows, np.uint8).reshape(truth.shape), axis=0, dtype=np.uint8)
            assert np.abs(STEP * steps.astype(int) - truth).max() <= STEP // 2


def test_pages_stay_small():
    assert len(static_text("viewer.js").encode()) <= 92_000
    assert len(viewer_page({}).encode()) <= 143_000


def test_view_writes_one_page(brick_path, tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or True)
    out = tmp_path / "site" / "brick.html"
    app(["view", str(brick_path), "--out", str(out)], standalone_mode=False)
    assert embedded(out.read_text()) == {"brick": brick_path.read_bytes()}
    assert opened == [out.as_uri()]
    assert str(out) in capsys.readouterr().out.replace("\n", "")


def test_view_refuses_what_is_no_object_file_and_two_of_one_object(brick_path, tmp_path):
    path = tmp_path / "a.safetensors"
    path.write_bytes(b"no Object File at all")
    refused(re.escape(str(path)), app, ["view", str(path), "--no-open"], standalone_mode=False)
    with pytest.raises(ObjectFolderError, match="another file has an object with the key brick"):
        app(["view", str(brick_path), str(brick_path), "--no-open"], standalone_mode=False)


@pytest.mark.parametrize("text", WORDS)
def test_pages_show_words_and_do_not_obey_them(tmp_path, text):
    def pages(words):
        missing = {"cup": {"material": words, "scale": 0.1}}
        report = write_site([], tmp_path / "site", missing, title=words)
        return Elements(viewer_page({words: b""}, words)), Elements(report.read_text(encoding="utf-8"))

    for page, plain in zip(pages(text), pages("plain")):
        assert page.elements == plain.elements
        expected = "".join(plain.texts).replace("plain", visible(text), 1)
        assert expected.partition(visible(text))[0] in "".join(page.texts)
        assert visible(text) in "".join(page.texts)
    rows = json.loads(next(shown for shown in pages(text)[1].texts if shown.startswith('{"rows"')))["rows"]
    assert [row["material"] for row in rows] == [text]


def sources(page):
    """Sources that the policy of a page allows, by directive."""
    policy = re.search('<meta http-equiv="Content-Security-Policy" content="([^"]*)">\n', page)
    assert policy.end() < min(page.index("<style"), page.index("<script"))
    return {name: allowed for name, *allowed in map(str.split, policy[1].split(";"))}


@pytest.mark.parametrize("name", ["page", "report", "listening"])
def test_a_page_runs_its_own_program_alone(name):
    names = re.findall(r"{{(\w+)}}", static_text(f"{name}.html"))
    program = static_text("viewer.js" if name == "page" else f"{name}.js")
    page = fill_page(f"{name}.html", dict.fromkeys(names, "") | {"script": program})
    allowed = sources(page)
    for directive in ("default-src", "base-uri", "form-action"):
        assert allowed[directive] == ["'none'"]
    inline = re.findall(r"<(script|style)>(.*?)</\1>", page, re.S)
    assert len(inline) == 2
    for kind, content in inline:
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in allowed[f"{kind}-src"]
    assert "unsafe" not in str(allowed)
    assert not {"http:", "https:", "*"} & {source for found in allowed.values() for source in found}


def test_frames_are_sandboxes():
    [frame] = Elements(viewer_frame({"a": b"b"})).elements
    assert frame == ("iframe", "srcdoc", "sandbox", "style", "allow")
    assert 'sandbox="allow-scripts"' in viewer_frame({})
    assert 'sandbox:"allow-scripts"' in static_text("report.js")


@has_node
def test_the_program_is_what_its_sources_give(tmp_path):
    subprocess.run(["node", "build.mjs", str(tmp_path)], cwd=VIEWER, check=True)
    for path in BUILT.iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), "run `make viewer`"


def drive(script, *arguments):
    command = ["node", f"tests/{script}", *map(str, arguments)]
    done = subprocess.run(command, cwd=VIEWER, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@has_node
def test_the_page_in_chromium(brick_path, tmp_path):
    page = tmp_path / "brick.html"
    page.write_text(viewer_page({"brick": brick_path.read_bytes()}))
    drive("drive.mjs", page, tmp_path)


def study(folder):
    for name in ("=a", "[b]"):
        (folder / name).mkdir()
        soundfile.write(folder / name / "<b>_1.wav", np.sin(np.arange(8000) / 5), 16000)
    page = folder / "listening.html"
    page.write_text(study_page(folder / "=a", folder / "[b]", pairs=1))
    return page


def shown(folder):
    page = folder / "view.html"
    page.write_text(viewer_page({" ".join(WORDS): b"no file"}, " ".join(WORDS)), encoding="utf-8")
    return page


def report(folder):
    missing = {"cup": {"material": " ".join(WORDS), "scale": 0.1}}
    return write_site([], folder / "site", missing, title=" ".join(WORDS))


@pytest.mark.slow
@has_node
@pytest.mark.parametrize("make", [study, shown, report])
def test_what_gets_into_a_page_is_not_run_in_chromium(make, tmp_path):
    drive("policy.mjs", make(tmp_path))

import dataclasses
import hashlib
import json
import logging
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from brick import SCALE, SIDES, build_brick
from refusals import refused

from objectfolder import ObjectFile
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material, material
from objectfolder.objectfile.parts import StoredParts
from objectfolder.sound.contact import contact_time, load_striker
from objectfolder.sound.gains_net import GainsNet, GainsShape
from objectfolder.sound.query import SoundSettings, Strikes
from objectfolder.sound.senses import ModalSense
from objectfolder.stored.reading import StoredNet
from objectfolder.stored.surface import TOLERANCE, ObjectSurface
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.profiles import load_profile
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at, sphere_points

TOP = np.array([[0.01, 0.005, SIDES[2] / 2 * SCALE]])
UP = np.array([[0.0, 0, 1]])


def in_parts(function, sizes, *arrays):
    edges = np.cumsum([0, *sizes])
    return np.concatenate([function(*(a[i:j] for a in arrays)) for i, j in pairwise(edges)])


# Every row is answered alike, to the bit, whatever else is in the batch.


def test_a_sound_does_not_depend_on_a_large_batch(brick, rng):
    points, forces = brick.sample_surface(1500), rng.standard_normal((1500, 3))
    whole = brick.impact(points, forces, duration=0.01)
    for i in (0, 15, 16, 1023, 1024, 1499):
        np.testing.assert_array_equal(brick.impact(points[i], forces[i], duration=0.01)[0], whole[i])


@pytest.mark.parametrize("modes", [1, 7, 250])
def test_a_sound_of_many_modes_does_not_depend_on_its_batch(brick, modes, rng):
    torch.manual_seed(modes)
    damped, damping = torch.rand(modes) * 4e4 + 1e3, torch.rand(modes) * 50 + 1
    used, shape = torch.ones(6**3, dtype=torch.bool), GainsShape(4, 8, 96, 96, 5.0)
    net = GainsNet(damped, damping, torch.rand(modes), used, shape)
    points, forces = brick.sample_surface(50) / SCALE, rng.standard_normal((50, 3))
    surface = ObjectSurface(lambda: brick.surface, 1.0)
    tensors, config = net.to_tensors()
    header = brick.header | {"audio": {"kind": "gains", "net": config}}
    sense = ModalSense(StoredNet("audio", header, tensors, surface, torch.device("cpu")))
    played = SoundSettings(16000, 0.1, "velocity", 0.0, None, None)

    def sounds(p, f):
        return sense.impact(Strikes(p, f, 0.02), played, lambda: None)

    whole, order = sounds(points, forces), rng.permutation(50)
    np.testing.assert_array_equal(sounds(points[order], forces[order]), whole[order])
    np.testing.assert_array_equal(in_parts(sounds, [1, 2, 3, 17, 27], points, forces), whole)


def test_a_view_does_not_depend_on_its_batch(brick, rng):
    cameras, lights = sphere_points(5, 2.5, rng), sphere_points(5, 1.0, rng)

    def views(c, l):
        return brick.view(c, l, 20)

    whole, order = views(cameras, lights), rng.permutation(5)
    np.testing.assert_array_equal(in_parts(views, [1, 3, 1], cameras, lights), whole)
    np.testing.assert_array_equal(views(cameras[order], lights[order]), whole[order])


# Seeing


def test_a_camera_is_a_position_or_a_pose(brick):
    position, light = np.array([[2.0, 1, 1]]), np.array([0.5, 0.5, 1])
    by_position = brick.view(position, light, 16)
    assert by_position.shape == (1, 16, 16, 3)
    assert by_position.dtype == np.float32
    assert by_position.min() >= 0
    assert by_position.max() <= 1
    np.testing.assert_array_equal(brick.view(look_at(position), light[None], 16), by_position)
    np.testing.assert_array_equal(brick.view(look_at(position)[0], light, 16), by_position)
    np.testing.assert_array_equal(brick.view(position[0], light, 16), by_position)
    wide = brick.view(position, light, intrinsics=Intrinsics(20, 10, 15.0))
    assert wide.shape == (1, 10, 20, 3)
    assert (by_position[0, 0] == by_position.max()).all()  # white around it


def test_rendering_gives_the_view_and_what_lies_under_it(brick):
    cameras, light = sphere_points(3, 2.5, np.random.default_rng(1)), np.array([0.5, 0.5, 1])
    intrinsics = Intrinsics(40, 24, 50.0, center=(18.0, 13.5))
    views = brick.render(cameras, light, intrinsics=intrinsics)
    np.testing.assert_array_equal(views.rgb, brick.view(cameras, light, intrinsics=intrinsics))
    assert views.rgba.shape == (3, 24, 40, 4)
    np.testing.assert_array_equal(views.alpha, views.rgba[..., 3])
    np.testing.assert_array_equal(np.isfinite(views.depth), views.alpha > 0)
    np.testing.assert_allclose(np.linalg.norm(views.normals, axis=-1), views.alpha > 0, atol=1e-5)
    for i, camera in enumerate(cameras):
        single = brick.render(camera, light, intrinsics=intrinsics)
        for name in ("rgb", "rgba", "depth", "normals"):
            np.testing.assert_array_equal(getattr(single, name)[0], getattr(views, name)[i])


def test_depth_is_in_metres_and_leads_back_to_the_surface(brick):
    """Points at their depth along their rays lie on the box."""
    intrinsics, pose = Intrinsics(30, 20, 40.0), look_at(np.array([1.4, 1.1, 1.7]))
    views = brick.render(pose, [1, 1, 1], intrinsics=intrinsics, supersample=False)
    rows, columns = np.nonzero(views.alpha[0])
    origins, directions = camera_rays(pose[0], intrinsics, np.stack([columns, rows], 1) + 0.5)
    depth = views.depth[0][rows, columns] / (directions @ -pose[0, :3, 2])
    points = origins * SCALE + directions * depth[:, None]  # object frame, metres
    outside = np.abs(points) / SCALE - np.array(SIDES) / 2
    assert len(points) > 50
    flat = np.sort(outside, 1)[:, 1] < -0.03  # away from edges, which the grid rounds
    np.testing.assert_allclose(outside.max(1)[flat], 0, atol=1e-3)
    np.testing.assert_allclose(outside.max(1), 0, atol=0.02)
    expected = np.eye(3)[outside.argmax(1)] * np.sign(points)
    np.testing.assert_allclose(views.normals[0][rows, columns][flat], expected[flat], atol=0.05)


def test_a_camera_that_does_not_see_the_object_sees_white(brick):
    image = brick.view(look_at(np.array([2.5, 0, 0]), (5, 0, 0)), [1, 0, 0], 8)
    np.testing.assert_allclose(image, 1, atol=1e-6)


@pytest.mark.parametrize("where", [0.0, 1e-9, -1e-6])
def test_a_light_on_the_surface_gives_a_finite_picture(brick, where):
    """Or a hair above or under it."""
    points = brick.sample_surface(4) / brick.scale
    images = brick.view(points * 4, points * (1 + where), 16)
    assert np.isfinite(images).all()
    assert (images >= 0).all()
    assert (images <= 1).all()
    assert (images < 0.999).any()


def test_a_camera_inside_the_object_sees_no_background(brick):
    image = brick.view([0.01, 0, 0], [0, 0, 1.0], 16)
    assert np.isfinite(image).all()
    assert (image < 1).any()


def test_a_camera_in_metres_is_warned_of_once(brick_path, caplog):
    brick = ObjectFile.load(brick_path)
    light, corner = [0, 0, 1.0], np.linalg.norm(SIDES) / 2
    brick.view([[2.0, 1, 1], [corner + 0.01, 0, 0]], light, 2)
    assert not caplog.messages
    for ask in (brick.render, brick.view):
        ask([[2.0, 1, 1], [0, 0.55, 0]], light, 2)
    (message,) = caplog.messages
    assert message.startswith("brick: the camera at [0.0, 0.55, 0.0] is inside the object's bounding ball")
    assert message.endswith("unit frame, in which the object's longest side is 1: divide metres by 0.1")


POSE = look_at(np.array([2.0, 1.0, 1.0]))[0]
MIRROR = np.diag([-1.0, 1, 1, 1])
NO_MOTIONS = [
    (POSE.T, "last row must be"),
    (POSE * 2, "last row must be"),
    (POSE @ np.diag([2.0, 2, 2, 1]), "of length 1 and orthogonal"),
    (POSE @ np.diag([1.0, 1, 1.001, 1]), "of length 1 and orthogonal"),
    (POSE @ MIRROR, "it mirrors"),
    (np.zeros((4, 4)), "last row must be"),
    (np.diag([0.0, 0, 0, 1]), "of length 1 and orthogonal"),
    (POSE + np.eye(4)[3][:, None] * 0.01, "last row must be"),
    (np.where(np.eye(4) > 0, np.nan, POSE), "last row must be|orthogonal"),
]
TOO_FAR = "row 0 is .*coordinates of at most 1000"  # for single precision
NONSENSE = [
    (np.zeros((2, 4)), [1, 0, 0], r"camera has shape \(2, 4\), expected \(N, 3\) or \(N, 4, 4\)"),
    (np.zeros(4), [1, 0, 0], "camera has shape"),
    (3.0, [1, 0, 0], "camera has shape"),
    (np.zeros((2, 3, 4)), [1, 0, 0], "camera has shape"),
    ([[0, 0, 0]], [1, 0, 0], r"camera: row 0 is \[0.0, 0.0, 0.0\], .* away from the point"),
    ([[np.nan, 0, 1]], [1, 0, 0], "finite"),
    (np.full((1, 4, 4), np.inf), [1, 0, 0], "camera: row 0 is .*inf.*expected finite coordinates"),
    ([[2, 0, 0]], [1, 0], r"light has shape \(2,\), expected \(N, 3\)"),
    ([[2, 0, 0]], [np.nan, 0, 0], r"light: row 0 is \[nan"),
    ([[2, 0, 0]] * 3, np.ones((2, 3)), "camera has 3 rows, light 2"),
    *((np.stack([POSE, matrix]), [1, 0, 0], f"camera: matrix 1 is .*{said}") for matrix, said in NO_MOTIONS),
]
for far in (2e19, 1e40, 1e200, 1001):
    moved = POSE + far * np.eye(4)[:, 3] * np.eye(4)[0][:, None]
    NONSENSE += [(camera, [1, 0, 0], f"camera: {TOO_FAR}") for camera in ([far, 0, 1], moved)]
    NONSENSE += [([2, 1, 1], [far, 0, 0], f"light: {TOO_FAR}")]
OTHERS = [
    ({"resolution": 0}, "resolution is 0, expected a whole number"),
    ({"resolution": -3}, "resolution is -3, expected a whole number"),
    ({"resolution": 10**6}, "needs .* bytes, this machine has"),
    ({"intrinsics": Intrinsics(np.int32(10**6), np.int32(10**6))}, "needs .* bytes, this machine has"),
    ({"intrinsics": 3}, "intrinsics is of type int"),
    ({"intrinsics": Intrinsics(8, 8, 10.0), "resolution": 8}, "resolution is 8, but intrinsics has a size"),
    ({"supersample": 1}, "supersample is of type int"),
    ({"lights": "sun"}, "lights is 'sun', expected 'studio'"),
    ({"light": None}, "there is no light"),
    ({"environment": np.zeros((4, 8, 3))}, "environment is black"),
]


@pytest.mark.parametrize("question", ["view", "render"])
def test_a_view_of_nonsense_is_refused_before_the_net_is_loaded(brick, monkeypatch, question):
    monkeypatch.setattr(StoredParts, "vision", property(lambda parts: pytest.fail("the net was loaded")))
    asked = [({"camera": camera, "light": light}, message) for camera, light, message in NONSENSE]
    asked += [({"camera": [2, 0, 0], "light": [1, 0, 0], **other}, message) for other, message in OTHERS]
    for arguments, message in asked:
        with pytest.raises(ObjectFolderError, match=message):
            getattr(brick, question)(**arguments)


# Hearing


def test_a_sound_is_linear_in_the_force_and_keeps_its_scale(brick, rng):
    points, a, b = brick.sample_surface(5), *rng.standard_normal((2, 5, 3))
    both = brick.impact(points, 2 * a - b)
    parts = 2 * brick.impact(points, a) - brick.impact(points, b)
    assert both.shape == (5, 32000)
    assert both.dtype == np.float32
    np.testing.assert_allclose(both, parts, atol=1e-5 * np.abs(both).max())
    # A power of two is exact (while no sample is subnormal).
    louder, plain = (brick.impact(points, f * a, duration=0.02) for f in (4, 1))
    np.testing.assert_array_equal(louder, 4 * plain)
    assert not brick.impact(points, 0 * a).any()


def test_a_sound_holds_the_objects_frequencies(brick):
    sound = brick.impact(TOP, UP, sample_rate=48000, duration=1.0)[0]
    spectrum = np.abs(np.fft.rfft(sound * np.hanning(len(sound))))
    heard = brick.frequencies[brick.frequencies < 24000]
    assert np.abs(heard - spectrum.argmax()).min() < 3
    assert sound[0] == 0
    early, late = sound[:4800], sound[-4800:]
    assert np.square(late).sum() < 1e-2 * np.square(early).sum()


def test_a_point_near_the_surface_is_snapped(brick):
    above = TOP + 0.5 * brick.surface.grid.spacing * SCALE * UP
    expected = brick.impact(TOP, UP)
    np.testing.assert_allclose(brick.impact(above, UP), expected, rtol=0, atol=1e-2 * np.abs(expected).max())


@pytest.mark.parametrize("question", ["impact", "mode_shapes", "touch", "press", "contact_normals"])
def test_a_point_off_the_surface_is_refused_with_row_and_distance(brick, question):
    points = brick.sample_surface(6)
    points[4] = [0, 0, SCALE]
    arguments = (points, np.ones((6, 3))) if question == "impact" else (points,)
    with pytest.raises(
        ObjectFolderError,
        match=r"1 of 6 points .*row 4 at \[0.0, 0.0, 0.1\] m, 0.085 m away; .*at most 0.002 m, 0.02 of the",
    ):
        getattr(brick, question)(*arguments)
    getattr(brick, question)(*arguments, tolerance=0.9)


def test_an_object_that_falls_silent_says_so(brick, caplog):
    rate = int(brick.frequencies[0])  # half of it is half of its lowest mode
    with caplog.at_level(logging.WARNING):
        sound = brick.impact(TOP, UP, sample_rate=rate, duration=0.1)
    assert not sound.any()
    assert sound.shape == (1, round(rate * 0.1))
    assert f"none of its 12 modes lies below half the sample rate, {rate // 2} Hz" in caplog.text
    caplog.clear()
    brick.impact(TOP, UP, duration=0.1)
    assert "silent" not in caplog.text


def test_an_object_whose_highest_modes_are_not_stored_says_so(brick, caplog):
    top = brick.header["audio"]["band_hz"][1]
    assert top < 20000
    own = brick.tuning()
    assert own.complete_hz == (0.0, top)
    assert own.notes == brick.tuning(scale=brick.scale).notes
    assert own.notes[0].startswith(f"incomplete: modes from {top:.0f} to 20000 Hz were above the band")
    loaded = ObjectFile(brick.header, brick.tensors)
    for _ in range(2):
        loaded.impact(TOP, UP, duration=0.1)
    assert caplog.text.count(f"brick: {own.notes[0]}") == 1  # not at every strike


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"frequency_uncertainty": 0.48}, "its lowest frequencies may be 48% wrong"),
        ({"frequency_uncertainty_unknown": True}, "how wrong its frequencies are is not known"),
    ],
)
def test_a_sound_that_is_marked_uncertain_says_so_once(brick, spectrograms, caplog, known, said):
    for file in (brick, spectrograms):
        audio = {k: v for k, v in file.header["audio"].items() if k != "frequency_uncertainty"} | known
        unmarked, marked = (
            ObjectFile(file.header | {"audio": audio | mark}, file.tensors)
            for mark in ({}, {"uncertain": True})
        )
        caplog.clear()
        expected = unmarked.impact(TOP, UP, duration=0.1)
        assert "uncertain" not in caplog.text  # whoever built it accepted the error
        for _ in range(2):
            np.testing.assert_array_equal(marked.impact(TOP, UP, duration=0.1), expected)
        if file is brick:
            marked.voice()
            assert marked.torch().sound is not None
        [record] = [record for record in caplog.records if "uncertain" in record.getMessage()]
        assert record.levelno == logging.WARNING
        assert record.getMessage().startswith(f"brick: its sound is marked uncertain: {said}, since walls or")
        assert "thicken them" in record.getMessage()


@pytest.mark.parametrize("ask", [lambda file: file.voice(), lambda file: file.torch().sound])
def test_sounds_that_go_on_or_carry_gradients_say_that_they_are_uncertain(brick, caplog, ask):
    audio = brick.header["audio"] | {"uncertain": True, "frequency_uncertainty": 0.48}
    ask(ObjectFile(brick.header | {"audio": audio}, brick.tensors))
    assert caplog.text.count("brick: its sound is marked uncertain") == 1


def test_an_object_without_any_mode_is_silent(tmp_path, caplog):
    tiny = build_brick(scale=0.002)
    tiny.save(tmp_path / "tiny.safetensors")
    tiny = type(tiny).load(tmp_path / "tiny.safetensors")
    assert tiny.frequencies.shape == (0,)
    sound = tiny.impact(tiny.sample_surface(2), UP, duration=0.1)
    assert sound.shape == (2, 1600)
    assert not sound.any()
    assert "silent: no mode rings between 20 Hz and 20 kHz" in caplog.text
    assert "sample rate" not in caplog.text


def test_impulses_too_large_for_the_format_are_refused_and_give_no_nan(brick):
    for size in (1e37, 1e300):
        with pytest.raises(ObjectFolderError, match=r"impulses of up to .* N s .*scale them down"):
            brick.impact(TOP, [[size, -size, size]], duration=0.1, response="acceleration")


def test_a_soft_strike_keeps_its_momentum_and_loses_its_treble(brick):
    hard, soft = (brick.impact(TOP, UP, 48000, 0.5, contact_time=t)[0] for t in (0.0, 1e-3))
    spectra = [np.abs(np.fft.rfft(sound)) for sound in (hard, soft)]
    assert spectra[1].sum() < 0.1 * spectra[0].sum()
    # What an impulse moves over all time is its integral times the static compliance.
    assert spectra[1][0] == pytest.approx(spectra[0][0], rel=0.05)


def test_a_strike_lasts_as_long_as_its_striker_touches_the_object(brick):
    plastic, mass = material("plastic"), 1070 * 0.18 * SCALE**3
    assert brick.contact_time() == pytest.approx(contact_time(load_striker("steel"), plastic, mass), rel=1e-4)
    iron = contact_time(load_striker("wood"), material("iron"), mass * 8000 / 1070 * 8)
    assert brick.contact_time("wood", "iron", 2 * SCALE) == pytest.approx(iron, rel=1e-4)
    for striker, named in (("steel", {}), ("finger", {"striker": "finger"})):
        by_hand = brick.impact(TOP, UP, duration=0.1, contact_time=brick.contact_time(striker))
        np.testing.assert_array_equal(brick.impact(TOP, UP, duration=0.1, **named), by_hand)
    without = ObjectFile({k: v for k, v in brick.header.items() if k != "solid"}, brick.tensors)
    assert without.contact_time() == contact_time(load_striker("steel"), plastic, np.inf)


def test_an_object_of_another_size_and_material_sounds_as_its_modes(brick, caplog):
    """The same as an Object File whose modes were scaled by hand."""
    glass = dataclasses.replace(material("glass"), poisson_ratio=material("plastic").poisson_ratio)
    size, density = 3.0, 2600 / 1070
    speed = np.sqrt(6.2e10 / 1.4e9 / density) / size
    w, c = (brick.tensors[f"audio.{name}"] for name in ("damped_frequency", "damping"))
    eigenvalues = (w**2 + c**2) * speed**2
    damping = (1.0 + 1e-7 * eigenvalues) / 2
    by_hand = ObjectFile(
        {**brick.header, "scale": SCALE * size},
        {
            **brick.tensors,
            "audio.damped_frequency": np.sqrt(eigenvalues - damping**2),
            "audio.damping": damping,
            "audio.amplitude": (brick.tensors["audio.amplitude"] / np.sqrt(density * size**3)).astype("f4"),
        },
    )
    points, forces = brick.sample_surface(4), np.eye(3)[[0, 1, 2, 2]]
    expected = by_hand.impact(points * size, forces, 48000, contact_time=0.0)
    heard = brick.tuning(glass, SCALE * size)
    assert len(heard.modes) == 12
    sounds = brick.impact(points * size, forces, 48000, contact_time=0.0, material=glass, scale=SCALE * size)
    np.testing.assert_allclose(sounds, expected, atol=1e-5 * np.abs(expected).max())
    assert "brick: incomplete: modes from" in caplog.text
    assert "approximate" not in caplog.text
    # Points are metres of the struck object.
    refused("off the surface", brick.impact, points, forces, material=glass, scale=SCALE * size)


def test_another_poisson_ratio_is_warned_of(brick_path, caplog):
    brick = ObjectFile.load(brick_path)  # warnings are said once of a file
    brick.impact(TOP, UP, duration=0.1, material="plastic")
    assert "approximate" not in caplog.text
    brick.impact(TOP, UP, duration=0.1, material="Steel")
    assert "brick: approximate: the modes were solved for plastic" in caplog.text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": np.zeros((2, 2))}, r"points has shape \(2, 2\), expected \(N, 3\)"),
        ({"points": [[0, np.nan, 0]]}, r"points: row 0 is \[0.0, nan, 0.0\], expected finite"),
        ({"points": TOP.repeat(3, 0), "forces": np.ones((2, 3))}, "points has 3 rows, forces 2"),
        ({"forces": [[0, 0, np.inf]]}, r"forces: row 0 is"),
        ({"forces": [[0, 0]]}, "forces has shape"),
        ({"material": "gold"}, "unknown material 'gold'"),
        ({"scale": 0.0}, "scale is 0.0, expected the object's longest side"),
        ({"scale": np.nan}, "scale is nan"),
        ({"contact_time": -1.0}, "contact time is -1.0 s"),
        ({"contact_time": np.nan}, "contact time is nan, expected a finite number"),
        ({"duration": 0.0}, "both must be positive"),
        ({"duration": np.nan}, "duration is nan, expected a finite number"),
        ({"sample_rate": np.nan}, "sample rate is nan, expected a finite number"),
        ({"response": "loud"}, "'loud' is not one of"),
        ({"sample_rate": 0}, "must be positive"),
        ({"tolerance": np.nan}, "tolerance is"),
        ({"tolerance": -0.01}, "tolerance is"),
    ],
)
def test_an_impact_of_nonsense_is_refused(brick, arguments, message):
    refused(message, brick.impact, **{"points": TOP, "forces": UP} | arguments)


UNDAMPED = Material("brass", 8500.0, 1.0e11, 0.34)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"delay": True}, "delay=True needs a listener; give listener, or leave delay out"),
        ({"contact_time": 1e-3, "striker": "steel"}, "striker is 'steel', but contact_time says .*leave one"),
        ({"contact_time": 0.0, "striker": load_striker("wood")}, r"striker is Striker\(.*, but contact_time"),
        ({"material": UNDAMPED}, "material 'brass': an undamped object rings for ever; give alpha, beta or"),
    ],
)
def test_arguments_that_would_be_ignored_are_refused(brick, arguments, message):
    for question in (brick.impact, brick.listen):
        refused(message, question, TOP, UP, **arguments)


def test_a_material_has_a_loss_factor_alone(brick):
    brass = dataclasses.replace(UNDAMPED, loss_factor=((1000.0, 5e-4), (10000.0, 1e-3)))
    given = dataclasses.replace(brass, alpha=3.0, beta=1e-7)  # which the loss factor replaces
    sound = brick.impact(TOP, UP, 48000, 0.2, material=brass)
    np.testing.assert_array_equal(brick.impact(TOP, UP, 48000, 0.2, material=given), sound)
    heard = brick.tuning(brass)
    hertz, loss = heard.frequencies.numpy(), heard.damping.numpy() / (np.pi * heard.frequencies.numpy())
    assert hertz.min() < 10000 < hertz.max()
    np.testing.assert_allclose(loss, np.interp(hertz, *zip(*brass.loss_factor)), rtol=1e-5)
    # How long a striker touches it, and its frequencies, do not depend on its damping.
    assert brick.contact_time(material=UNDAMPED) == brick.contact_time(material=brass)
    np.testing.assert_allclose(brick.tuning(UNDAMPED).frequencies.numpy(), hertz, rtol=1e-6)


def test_a_voice_needs_a_sample_rate_and_damping(brick):
    for rate, said in ((0, "0 Hz"), (-1.5, "-1.5 Hz"), (np.nan, "nan"), (np.inf, "inf"), ("fast", "'fast'")):
        refused(f"^sample_rate is {said}, expected a (positive|finite)", brick.voice, rate)
    refused("material 'brass': an undamped object rings for ever", brick.voice, material=UNDAMPED)


# Feeling


def test_a_touch_answers_with_images(brick):
    images = brick.touch(TOP.repeat(2, 0), [0.0005, 0.001])
    assert images.shape == (2, 160, 120, 3)
    assert images.dtype == np.uint8
    assert not np.array_equal(images[0], images[1])
    np.testing.assert_array_equal(brick.touch(TOP[0]), brick.touch(TOP))
    # The top is flat: turning the sensor about its normal changes nothing.
    np.testing.assert_allclose(brick.touch(TOP, angle=0.7).astype(int), brick.touch(TOP).astype(int), atol=2)
    assert np.abs(brick.touch(TOP, tilt=0.1).astype(int) - brick.touch(TOP)).max() > 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"depth": [0.001, -0.001]}, r"depth: row 1 is -0.001 m; the sensor 'digit' takes 0 to 0.003 m"),
        ({"depth": 0.5}, r"depth: row 0 is 0.5 m; the sensor 'digit' takes 0 to"),
        ({"depth": 0.0035, "sensor": "gelsight_mini"}, "the sensor 'gelsight_mini' takes 0 to"),
        ({"depth": [0.001, np.nan]}, "depth: row 1 is nan, expected finite numbers"),
        ({"depth": [0.001] * 3}, r"depth has shape \(3,\), expected one number or 2 of them"),
        ({"angle": [[0.0]]}, r"angle has shape \(1, 1\), expected one number or 2"),
        ({"tilt": np.inf}, "tilt: row 0 is inf"),
        ({"tilt": 15}, "tilt: row 0 is 15 rad, expected at most 1.57 either way; angles are in radians"),
        ({"tilt": [0.1, -np.pi]}, "tilt: row 1 is -3.14159 rad, expected at most 1.57"),
        ({"tilt": np.nextafter(np.pi / 2, 2) + 2e-6}, "tilt: row 0 is 1.5708 rad"),
        ({"azimuth": [0.0, np.nan]}, "azimuth: row 1 is nan"),
        ({"sensor": "gelsite"}, "unknown sensor profile 'gelsite': expected one of digit"),
        ({"sensor": "none.yaml"}, "sensor profile 'none.yaml': there is no such file; give .*names digit, "),
    ],
)
def test_a_touch_of_nonsense_is_refused(brick, arguments, message):
    for question in (brick.touch, brick.press):
        refused(message, question, TOP.repeat(2, 0), **arguments)


def test_a_sensor_may_lean_by_a_right_angle(brick):
    """In either direction, and rounded to single precision."""
    right = torch.tensor([torch.pi / 2, -torch.pi / 2])
    assert right[0].item() > np.pi / 2
    leaning = brick.press(TOP.repeat(2, 0), 5e-4, tilt=right, azimuth=[0, np.pi])
    assert np.isfinite(leaning.force).all()
    np.testing.assert_allclose(leaning.height[0], leaning.height[1], atol=1e-6)  # the same pose


def test_contact_normals_are_those_of_a_touch(brick):
    """Points within a voxel of the surface stay where they are; others near it are snapped to it."""
    voxel = brick.surface.grid.spacing
    points = brick.sample_surface(20, seed=2)
    for lifted in (0.0, 0.9 * voxel):
        kept = points + lifted * SCALE * brick.contact_normals(points)
        feet = brick.surface.grid.smooth_distance, kept / brick.scale, NORMAL_RADIUS
        np.testing.assert_array_equal(brick.contact_normals(kept), contact_normals(*feet))
    normals = brick.contact_normals(points)
    near = brick.nearest(points + 0.4 * voxel * SCALE * normals)[0]
    above = near + (0.5 * (voxel + TOLERANCE)) * SCALE * brick.contact_normals(near)
    assert (brick.nearest(above)[1] > voxel * SCALE).all()
    snapped = brick.nearest(above)[0]
    np.testing.assert_allclose(brick.contact_normals(above), brick.contact_normals(snapped), atol=1e-6)
    assert brick.contact_normals(np.zeros((0, 3))).shape == (0, 3)


def test_everything_about_a_touch_in_one_answer(brick):
    """On a flat face, against what the definitions say."""
    points = TOP.repeat(3, 0)
    depths, angles = np.array([0.0, 0.0005, 0.001]), np.array([0.0, 0.4, 2.0])
    found = brick.press(points, depths, angles)
    np.testing.assert_array_equal(found.images, brick.touch(points, depths, angles))
    np.testing.assert_allclose(found.max_penetration, depths, atol=3e-5)
    assert (np.diff(found.force) > 0).all()
    assert (found.obstructed == 0).all()
    np.testing.assert_array_equal(found.mask, found.pressure > 0)
    np.testing.assert_array_equal(found.displacement[found.mask], found.height[found.mask])
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=-1), 1, atol=1e-5)
    # Where the flat face presses, the gel is flat.
    assert (found.normals[2][60:100, 45:75] @ [-1.0, 0, 0]).min() > np.cos(np.radians(2))
    assert found.profile.name == "digit"


def test_touches_are_answered_row_by_row(brick, rng):
    """Whatever else is asked for at once, the bits are the same."""
    points = brick.sample_surface(35, seed=4)
    pose = rng.uniform(0, 0.002, 35), rng.uniform(0, 6, 35), rng.choice([0, 0.1], 35), rng.uniform(0, 6, 35)
    whole = brick.press(points, *pose)
    for rows in ([3], [34, 0], list(range(20))):
        found = brick.press(points[rows], *(of[rows] for of in pose))
        for field in ("images", "height", "normals", "mask", "pressure", "force", "area", "obstructed"):
            np.testing.assert_array_equal(getattr(found, field), getattr(whole, field)[rows])
    parts = list(brick.touches(points, *pose))
    assert len(parts) > 1
    np.testing.assert_array_equal(np.concatenate([part.force for part in parts]), whole.force)


def test_another_sensor_feels_the_same_object(brick, tmp_path):
    mini = load_profile("gelsight_mini")
    found = brick.press(TOP, sensor="gelsight_mini")
    assert found.images.shape == (1, mini.height, mini.width, 3)
    assert found.profile == mini
    stiff = dataclasses.replace(load_profile("digit"), young_modulus=3e5)
    path = tmp_path / "stiff.yaml"
    path.write_text(json.dumps(stiff.to_dict()))
    for sensor in (stiff, path, str(path)):
        force = brick.press(TOP, sensor=sensor).force
        np.testing.assert_allclose(force, brick.press(TOP).force * 3e5 / 1.5e5, rtol=1e-3)
    rigid = brick.press(TOP, sensor="tacto_digit")
    assert np.isnan(rigid.force).all()
    assert rigid.area > 0


def test_a_point_next_to_the_stored_surface_is_believed(brick):
    """The sensor goes where the caller says, up to a voxel; beyond, to the surface."""
    voxel = 0.1 * brick.surface.grid.spacing
    high = brick.press(TOP + 0.2 * voxel * UP).max_penetration
    higher = brick.press(TOP + 0.95 * voxel * UP).max_penetration
    far = brick.press(TOP + 1.05 * voxel * UP).max_penetration
    at = brick.press(TOP).max_penetration
    assert at - high == pytest.approx(0.2 * voxel, rel=0.05)
    assert higher == 0  # a voxel of this coarse grid is deeper than the press
    assert far == pytest.approx(at, abs=0.05 * voxel)


def test_no_rows_no_answers(brick):
    none = np.zeros((0, 3))
    views = brick.render(none, [0, 0, 1], 8)
    assert views.rgb.shape == brick.view(none, [0, 0, 1], 8).shape == (0, 8, 8, 3)
    assert views.depth.shape == (0, 8, 8)
    assert brick.view(np.zeros((0, 4, 4)), none, 8).shape == (0, 8, 8, 3)
    assert brick.impact(none, none, duration=0.1).shape == (0, 1600)
    assert brick.impact(none, UP, duration=0.1).shape == (0, 1600)
    assert brick.touch(none).shape == brick.press(none).normals.shape == (0, 160, 120, 3)
    assert brick.press(none).force.shape == (0,)
    assert brick.touch(none, none[:, 0], none[:, 0]).shape == (0, 160, 120, 3)


def test_queries_leave_their_arguments_and_the_random_state_alone(brick):
    points, forces = brick.sample_surface(3), np.ones((3, 3))
    kept = points.copy(), forces.copy()
    before, legacy = torch.random.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    brick.impact(points, forces, duration=0.1)
    brick.touch(points)
    brick.view([2.0, 1, 1], [1, 0, 0], 8)
    np.testing.assert_array_equal(points, kept[0])
    np.testing.assert_array_equal(forces, kept[1])
    assert torch.equal(torch.random.get_rng_state(), before)
    np.testing.assert_array_equal(np.random.get_state()[1], legacy)  # noqa: NPY002


def test_tensors_in_tensors_out(brick, rng):
    points, forces = brick.sample_surface(3), rng.standard_normal((3, 3))
    cameras, lights = sphere_points(2, 2.5, rng), sphere_points(2, 1.0, rng)
    for question, first, rest in (
        (lambda p, f: brick.impact(p, f, duration=0.05), points, forces),
        (lambda p, d: brick.touch(p, depth=d), points, np.full(3, 0.0007)),
        (lambda c, l: brick.view(c, l, 24), cameras, lights),
    ):
        arrays = question(first, rest)
        tensors = question(torch.from_numpy(first), torch.from_numpy(rest))
        assert isinstance(arrays, np.ndarray)
        assert isinstance(tensors, torch.Tensor)
        assert tensors.device == torch.device("cpu")
        np.testing.assert_array_equal(tensors.numpy(), arrays)
        assert isinstance(question(first, torch.from_numpy(rest)), np.ndarray)


def test_the_nearest_points_bounds_and_mesh_of_a_brick(brick, rng):
    half = np.array(SIDES) * SCALE / 2
    np.testing.assert_allclose(brick.bounds, [-half, half], atol=0.01 * SCALE)
    outside = half * [3, 0.2, 0.2]
    nearest, distance = brick.nearest(outside)
    np.testing.assert_allclose(nearest, [half * [1, 0.2, 0.2]], atol=0.01 * SCALE)
    np.testing.assert_allclose(distance, 2 * half[0], atol=0.01 * SCALE)
    assert brick.nearest(np.zeros((0, 3)))[0].shape == (0, 3)
    mesh = brick.to_mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(np.prod(SIDES) * SCALE**3, rel=0.03)
    np.testing.assert_array_equal(mesh.bounds, brick.bounds)
    points = brick.sample_surface(200, seed=3)
    nearest, distance = brick.nearest(points)
    assert distance.max() < 0.25 * brick.surface.grid.spacing * SCALE
    np.testing.assert_allclose(np.linalg.norm(nearest - points, axis=1), distance, atol=1e-12)


def _mixed(file, count, seed):
    """Queries of all kinds in random order, each a function of nothing."""
    rng = np.random.default_rng(seed)
    points = file.sample_surface(count, seed)
    asked = []
    for point, force, kind in zip(points, rng.standard_normal((count, 3)), rng.integers(0, 20, count)):
        if kind == 0:
            camera, light = (sphere_points(1, radius, rng) for radius in (2.5, 1.0))
            asked.append(partial(file.view, camera, light, 16))
        elif kind < 4:
            asked.append(partial(file.touch, point, rng.uniform(0, 0.001), rng.uniform(0, 6)))
        elif kind == 4:
            asked.append(partial(file.impact, point, force, 8000, 0.05, material="steel", scale=SCALE))
        else:
            asked.append(partial(file.impact, point, force, duration=0.05))
    return asked


@pytest.mark.parametrize("count", [150, pytest.param(10000, marks=pytest.mark.slow)])
def test_threads_get_the_bytes_that_one_gets(brick_path, count):
    def digests(pool):
        # Opened here: the parts are read while threads ask for them.
        asked = _mixed(ObjectFile.load(brick_path), count, seed=5)
        return list(pool(lambda ask: hashlib.sha256(ask().tobytes()).digest(), asked))

    with ThreadPoolExecutor(4) as threads:
        together = digests(threads.map)
    assert together == digests(map)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_matrices_of_single_precision_are_rotations(brick, kind, rng):
    poses = look_at(sphere_points(50, 2.5, rng)).astype(kind)
    assert np.isfinite(brick.view(poses, [1, 0, 0], 2)).all()


def test_masked_values_are_refused(brick):
    masked = np.ma.array([[0.0, 0, 0.015]], mask=[[True, False, False]])
    for ask in (brick.nearest, brick.touch, brick.mode_shapes, lambda p: brick.impact(p, UP)):
        refused("points holds masked values", ask, masked)
        refused("points holds masked values", ask, [masked[0]])
        ask(np.ma.array(masked.data))


def test_a_point_beyond_the_range_of_numbers_has_no_nearest_one(brick):
    refused(r"points: row 0 is \[1e\+200, 0.0, 0.0\], expected coordinates", brick.nearest, [[1e200, 0, 0]])
    nearest, distance = brick.nearest([[1e4, 0, 0]])
    assert abs(nearest[0, 0] - SCALE / 2) < 0.01 * SCALE
    assert abs(distance[0] - 1e4) < SCALE


def test_one_row_serves_all_of_the_others(brick):
    point, forces = brick.sample_surface(1), np.eye(3)
    both, depths = np.repeat(point, 2, 0), [0.0005, 0.001]
    sounds = brick.impact(point, forces)
    np.testing.assert_array_equal(sounds, brick.impact(point.repeat(3, 0), forces))
    np.testing.assert_array_equal(sounds[2:], brick.impact(point[0], UP[0]))
    np.testing.assert_array_equal(brick.impact(both, UP), brick.impact(both, UP.repeat(2, 0)))
    lights = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    images = brick.view([2.5, 0, 0], lights, resolution=16)
    np.testing.assert_array_equal(images, brick.view([[2.5, 0, 0]] * 2, lights, resolution=16))
    np.testing.assert_array_equal(brick.touch(point, depths), brick.touch(both, depths))
    np.testing.assert_array_equal(brick.press(point, depths).force, brick.press(both, depths).force)
    shears = [[0.0, 0.0], [1e-4, 0.0]]
    np.testing.assert_array_equal(
        brick.press(point, shear=shears).shear_force, brick.press(both, shear=shears).shear_force
    )
    felt = brick.torch().touch(torch.from_numpy(point), torch.tensor(depths))
    np.testing.assert_allclose(felt.force.numpy(), brick.press(both, depths).force, rtol=1e-3)
    refused("depth has shape", brick.touch, np.repeat(point, 3, 0), depths)

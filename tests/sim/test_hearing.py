import mujoco
import numpy as np
import pytest
from brick import without
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import hearing
from objectfolder.sim.body import add_body, rigid_body, scaled_body
from objectfolder.sim.export import write_mjcf
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.impacts import restitution
from objectfolder.sim.sounding import Sounding

RATE = 48000
PLANE = mujoco.mjtGeom.mjGEOM_PLANE


@pytest.fixture(scope="module")
def bell():
    return ObjectFile.sample("bell")


def scene(files, height=0.05, step=0.002, ear=(0.4, -0.3, 0.3), **options):
    """Objects above a table, turned a little, each of its convex hull, with an ear that moves with each."""
    spec = mujoco.MjSpec()
    spec.option.timestep = step
    spec.worldbody.add_geom(name="table", type=PLANE, size=[2, 2, 0.1], **options)
    spec.worldbody.add_site(name="ear", pos=ear)
    for k, file in enumerate(files):
        body = add_body(spec, rigid_body(file, [file.to_mesh().convex_hull]), file.key)
        body.pos, body.quat = [0.3 * k, 0, height + file.scale / 2], [0.95, 0.25, 0.18, 0]
        body.add_site(name=f"{file.key}_ear", pos=ear)
    return spec.compile()


def dropped(model, objects, seconds=1.0, listener="ear"):
    """Let all fall; return the sound, the strikes and the hearing."""
    data, hearing = mujoco.MjData(model), Hearing(model, objects, listener)
    sounds, strikes = [], []
    for _ in range(round(seconds / model.opt.timestep)):
        sounds.append(hearing.simulate(data))
        strikes += hearing.strikes
    return np.concatenate(sounds), strikes, hearing


def offline(file, strikes, listeners, samples):
    """The same strikes, each asked of the Object File; (L, samples)."""
    out = np.zeros((len(listeners), samples))
    for strike in strikes:
        left = samples - strike.start
        points = np.tile(strike.point, (len(listeners), 1))
        out[:, strike.start :] += file.impact(
            points, strike.impulse[None], RATE, left / RATE, tolerance=0.3,
            contact_time=strike.contact_time, listener=listeners,
        )  # fmt: skip
    return out


@pytest.fixture
def smooth(monkeypatch):
    """Surfaces without roughness, whose contacts make no noise."""
    monkeypatch.setattr(hearing, "scrape_force", lambda load, *_: (0 * load, load))


def test_a_dropped_bell_sounds_as_the_same_strikes_asked_of_its_file(bell, smooth):
    """The first second; the ear keeps its place in the bell's frame."""
    heard, strikes, _ = dropped(scene([bell]), [bell], listener="bell_ear")
    assert len(strikes) > 3
    expected = offline(bell, strikes, [[0.4, -0.3, 0.3]], RATE)[0]
    assert abs(heard - expected).max() < 1e-4 * abs(expected).max()


def test_a_dropped_bell_gives_less_than_the_energy_of_its_fall(bell, smooth):
    """What it radiates in all directions, and what its vibrations lose."""
    model, height = scene([bell]), 0.05
    _, strikes, hearing = dropped(model, [bell], listener="bell_ear")
    index = np.arange(24) + 0.5
    z, turn = 1 - 2 * index / 24, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z**2)
    places = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], 1)
    pressure = offline(bell, strikes, places, RATE)
    radiated = 4 * np.pi * np.square(pressure).mean(0).sum() / RATE / (1.204 * 343.2)
    damped = sum(strike.energy for strike in strikes) - hearing.energy()["bell"]
    impacts = sum(strike.lost for strike in strikes)
    fall = model.body_mass[1] * 9.81 * (height + bell.scale / 2)
    assert 0 < radiated + damped < impacts < fall
    assert damped > 0.005 * impacts


@pytest.mark.parametrize("step", [0.002, pytest.param(0.001, marks=pytest.mark.slow)])
def test_strikes_have_the_impulse_that_the_simulation_applies(bell, step):
    """Without weight, the bell flies against the table and back, with one or several strikes."""
    model = scene([bell], step=step, solref=[0.01, 1])
    model.opt.gravity[:] = 0
    data, hearing = mujoco.MjData(model), Hearing(model, [bell], "ear")
    data.qvel[2] = -1.0
    found = 0.0
    for _ in range(round(0.25 / step)):
        hearing.simulate(data)
        found += sum((data.xmat[1].reshape(3, 3) @ strike.impulse)[2] for strike in hearing.strikes)
    assert found == pytest.approx(model.body_mass[1] * (data.qvel[2] + 1.0), rel=0.15)


def test_one_call_of_many_steps_is_as_many_calls_of_one(brick):
    model = scene([brick])
    sounds = []
    for sizes in ([200], [1] * 200, [50, 1, 149]):
        data, hearing = mujoco.MjData(model), Hearing(model, [brick], "ear")
        sounds.append(np.concatenate([hearing.simulate(data, size) for size in sizes]).tobytes())
    assert sounds[1:] == sounds[:1] * 2
    assert np.frombuffer(sounds[0], np.float32).any()


def test_steps_may_be_shorter_than_a_sample(brick):
    """With rough surfaces, too. Steps without a sample lose no strike, and start none early."""
    model, rate = scene([brick], height=0.0, step=1e-4), 8000
    data, hearing = mujoco.MjData(model), Hearing(model, [brick], "ear", rate)
    parts, strikes, times = [], [], []
    for _ in range(1500):
        parts.append(hearing.simulate(data))
        strikes += hearing.strikes
        times += [data.time] * len(hearing.strikes)
    assert {len(part) for part in parts} == {0, 1}
    sound = np.concatenate(parts)
    assert len(sound) == 1200
    assert len(strikes) > 3
    assert [s.start for s in strikes] == pytest.approx(np.array(times) * rate, abs=1.5)
    assert not sound[: strikes[0].start].any()
    assert abs(sound[strikes[0].start :]).max() > 1e-3


def test_the_noise_of_a_slide_is_seeded_and_fades_as_it_stops(brick):
    def slid(seed, speed):
        model = scene([brick], 0.0)
        data = mujoco.MjData(model)
        data.qpos[:] = [0, 0, brick.scale * 0.15, 1, 0, 0, 0]
        hearing = Hearing(model, [brick], "ear", seed=seed)
        hearing.simulate(data, 20)  # settles
        data.qvel[0] = speed
        sound = hearing.simulate(data, 60)
        return sound, hearing.simulate(data, 200)[-4800:]

    sound, after = slid(0, 0.5)
    assert slid(0, 0.5)[0].tobytes() == sound.tobytes()
    assert slid(1, 0.5)[0].tobytes() != sound.tobytes()
    assert np.square(after).mean() < 1e-4 * np.square(sound).mean()


def test_two_objects_that_collide_both_sound(brick, bell):
    """In free fall, one is shot at the other; the table is far below."""
    model = scene([brick, bell], height=1.0)
    data, hearing = mujoco.MjData(model), Hearing(model, [brick, bell], "ear")
    data.qvel[0] = 2.0
    struck = []
    while not struck:
        hearing.simulate(data)
        struck = hearing.strikes
        assert data.time < 0.3
    assert {strike.body for strike in struck} == {"brick", "bell"}
    world = {}
    for strike in struck:
        turn = data.body(strike.body).xmat.reshape(3, 3)
        world[strike.body] = world.get(strike.body, 0) + turn @ strike.impulse
    assert world["brick"] == pytest.approx(-world["bell"], abs=1e-9)


@pytest.mark.slow
def test_a_listener_in_the_world_hears_the_bell_turn(bell, smooth):
    """The falling bell turns and comes nearer: another sound than in an ear that moves with it."""
    still, moving = (dropped(scene([bell]), [bell], 0.3, name)[0] for name in ("bell_ear", "ear"))
    levels = [10 * np.log10(np.square(sound).mean()) for sound in (still, moving)]
    assert abs(still - moving).max() > 0.01 * abs(still).max()
    assert abs(levels[0] - levels[1]) < 12


def test_an_exported_object_sounds_in_any_scene(brick, tmp_path):
    path = write_mjcf(brick, tmp_path, hulls=[brick.to_mesh().convex_hull])
    floor = '<worldbody><geom type="plane" size="1 1 .1" pos="0 0 -0.06"/></worldbody>'
    (path.parent / "scene.xml").write_text(f'<mujoco><include file="{path.name}"/>{floor}</mujoco>')
    model = mujoco.MjModel.from_xml_path(str(path.parent / "scene.xml"))
    hearing = Hearing(model, {brick.key: brick}, [0.3, 0.2, 0.4])
    assert abs(hearing.simulate(mujoco.MjData(model), 200)).max() > 1e-3


def test_another_material_and_size_is_heard_as_such(brick):
    body = rigid_body(brick, [brick.to_mesh().convex_hull])
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=PLANE, size=[1, 1, 0.1])
    thing = add_body(spec, scaled_body(body, 1.5, 7850 / 1070), "thing")
    thing.pos, thing.quat = [0, 0, 0.12], [0.9, 0.3, 0.2, 0]
    model = spec.compile()
    objects = {"thing": Sounding(brick, "steel", 0.15)}
    sound = Hearing(model, objects, [0.3, 0, 0.3]).simulate(mujoco.MjData(model), 300)
    rings = np.diff(sound[-9600:] * np.hanning(9600))
    peak = np.fft.rfftfreq(len(rings), 1 / RATE)[abs(np.fft.rfft(rings)).argmax()]
    assert abs(brick.tuning("steel", 0.15).frequencies.numpy() - peak).min() < 10
    refused(r"weighs .* kg in the scene.*Sounding", Hearing, model, {"thing": brick}, [0.3, 0, 0.3])


def test_a_file_without_radiation_is_heard_by_plane_waves(brick):
    """An upper estimate: louder than what is stored, by less than 25 dB."""
    model, plain = scene([brick]), without(brick, "radiation")
    levels = [10 * np.log10(np.square(dropped(model, [file], 0.4)[0]).mean()) for file in (brick, plain)]
    assert -3 < levels[1] - levels[0] < 25


@pytest.mark.parametrize("reference", [(0.02, 1.0), (0.02, 0.3), (0.02, 2.0), (-2500.0, -40.0)])
def test_restitution_is_that_of_a_spring_and_a_damper_that_cannot_pull(reference):
    first, second = reference
    stiffness, damping = (1 / (first * second) ** 2, 2 / first) if first > 0 else (-first, -second)
    x, v, dt = 0.0, 1.0, 1e-6
    while stiffness * x + damping * v > 0:
        v -= (stiffness * x + damping * v) * dt
        x += v * dt
    assert restitution(first, second) == pytest.approx(-v, abs=2e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"listener": ["ear", "brick_ear"]}, r"expected one; .*two ears need a Hearing each"),
        ({"listener": [[0, 0, 1], [0, 1, 1]]}, r"expected one position.*two ears need a Hearing each"),
        ({"listener": [0, 0, np.nan]}, "three finite numbers"),
        ({"listener": "nose"}, r"no site 'nose', but \['ear', 'brick_ear'\]"),
        ({"sample_rate": 2000}, r"lowest mode is at \d+ Hz, above half the sample rate of 2000 Hz"),
        ({"sample_rate": -1}, "sample_rate is -1 Hz, expected a positive number"),
        ({"surroundings": "cheese"}, "unknown material 'cheese'"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_arguments_are_refused(brick, change, message):
    arguments = {"objects": [brick], "listener": "ear"} | change
    refused(message, Hearing, scene([brick]), **arguments)


def test_scenes_that_cannot_be_heard_are_refused(brick, bell):
    for options, file, message in (
        ({}, bell, r"no body 'bell', but \['brick'\]"),
        ({"step": 0.02}, brick, "time step of the scene is 0.02 s, expected at most 0.01"),
        ({"solref": [0.002, 1]}, brick, "geom 'table'.*time constant of 0.002 s, expected at least"),
    ):
        refused(message, Hearing, scene([brick], **options), [file], "ear")
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="table", type=PLANE, size=[2, 2, 0.1])
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.add_geom(name="ball", size=[0.1, 0, 0])
    spec.add_pair(name="thud", geomname1="table", geomname2="ball", solref=[0.002, 1])
    with pytest.raises(ObjectFolderError, match=r"pair 'thud'.*time constant of 0.002 s, expected at least"):
        Hearing(spec.compile(), [], [0, 0, 1])
    model = scene([brick])
    model.mesh_vert[:] *= 2
    refused(r"geoms of body 'brick' reach from", Hearing, model, [brick], "ear")


def test_a_simulation_that_jumps_is_refused(brick):
    model = scene([brick])
    data, hearing = mujoco.MjData(model), Hearing(model, [brick], "ear")
    hearing.simulate(data, 3)
    mujoco.mj_step(model, data, 2)
    refused(r"call hear\(\) after every mj_step", hearing.hear, data)
    hearing.reset(data)
    hearing.simulate(data, 3)


@pytest.mark.parametrize("speed", [1e30, np.nan])
def test_a_simulation_that_mujoco_has_set_back_is_said_to_diverge(brick, speed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    model = scene([brick])
    data, hearing = mujoco.MjData(model), Hearing(model, [brick], "ear")
    hearing.simulate(data, 3)
    data.qvel[0] = speed
    refused(r"the simulation diverged after 0\.006 s", hearing.simulate, data)
    mujoco.mj_resetData(model, data)
    hearing.reset(data)
    hearing.simulate(data, 3)

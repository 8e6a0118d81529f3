"""What the page is told to hear at a listener, in viewer/tests/heard.json, is what the library computes.

`python tests/viewer/test_heard.py` writes that file anew.
"""

import base64
import json
from pathlib import Path

import numpy as np
import torch

from objectfolder.sound.click import SOUND_SPEED, Recoil, recoil_pressure
from objectfolder.sound.radiation.farfield import FarField, pack_far_field, unpack_far_field
from objectfolder.sound.radiation.harmonics import degrees
from objectfolder.sound.synthesis import force_factors, half_sine, responses

FILE = Path(__file__).parents[2] / "viewer" / "tests" / "heard.json"
SCALE, SIZE, DENSITY, VOLUME, RADIUS = 0.2, 1.5, 2400.0, 0.11, 0.6
RATE, SAMPLES, FACTOR = 44100.0, 400, SIZE**-1.5  # of the mode shapes
FREQUENCY = 2 * np.pi * np.array([900.0, 2600.0, 7300.0])
DAMPING, GAINS = np.array([15.0, 40.0, 160.0]), np.array([0.7, -1.3, 2.0])
LISTENER, IMPULSE = np.array([1.1, -0.7, 0.9]), np.array([0.3, -0.2, 1.0])


def heard() -> dict:
    rng = np.random.default_rng(0)
    orders = np.array([2, 5, 9])
    values = rng.normal(size=(3, 100)) + 1j * rng.normal(size=(3, 100))
    values *= degrees(9) <= orders[:, None]
    packed = pack_far_field(FarField(orders, values, RADIUS * SCALE), 10_000)
    field = unpack_far_field(packed, RADIUS * SCALE)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    recoil = {"centre": [0.02, -0.05, 0.1], "axes": turn.tolist(), "radii": [0.3, 0.35, 0.4]}
    side, place = SCALE * SIZE, (LISTENER * SCALE * SIZE)[None]
    w = FREQUENCY / SIZE  # of the larger body
    pressure = SIZE * field.pressure(FREQUENCY / SOUND_SPEED, place / SIZE)[0]
    gains = FACTOR * GAINS * pressure.conj() * (-DAMPING + 1j * w) ** 2
    body = Recoil(
        DENSITY * VOLUME * side**3, np.array(recoil["centre"]) * side, turn, np.array(recoil["radii"]) * side
    )
    sounds = []
    for contact in (0.0, 4e-4):
        modes = torch.from_numpy(w), torch.from_numpy(DAMPING), RATE, range(SAMPLES), "displacement", contact
        parts = [responses(*modes, ahead).numpy() for ahead in (False, True)]
        click = recoil_pressure(body, IMPULSE[None], place, RATE, SAMPLES, contact)[0]
        sound = gains.real @ parts[0] + gains.imag @ parts[1] + click
        if contact:
            pulse = half_sine(torch.arange(SAMPLES, dtype=torch.float64) / RATE, contact)
            for wave, turn in zip(pulse, force_factors(-DAMPING + 1j * w, contact)):
                sound += (gains * turn / w).imag.sum() * wave.numpy()
        sounds.append({"contact": contact, "samples": [float(f"{value:.6g}") for value in sound]})
    body = {
        "scale": SCALE,
        "size": SIZE,
        "density": DENSITY,
        "volume": VOLUME,
        "radius": RADIUS,
        "recoil": recoil,
    }
    field = {name: packed[name].tolist() for name in ("orders", "steps")}
    field["coefficients"] = base64.b64encode(packed["coefficients"].tobytes()).decode()
    modes = {
        "own": FREQUENCY,
        "frequency": w,
        "damping": DAMPING,
        "factor": np.float64(FACTOR),
        "gains": GAINS,
    }
    strike = {"listener": LISTENER, "impulse": IMPULSE}
    told = {name: value.tolist() for name, value in (modes | strike).items()}
    return body | field | told | {"rate": RATE, "sounds": sounds}


def test_the_pages_truth_is_what_the_library_computes():
    stored, now = json.loads(FILE.read_text()), heard()
    for old, new in zip(stored.pop("sounds"), now.pop("sounds"), strict=True):
        peak = np.abs(new["samples"]).max()
        np.testing.assert_allclose(old["samples"], new["samples"], atol=1e-5 * peak)
    del stored["coefficients"], now["coefficients"]  # as the library packs them
    for name, value in now.items():
        if name != "recoil":
            np.testing.assert_allclose(stored[name], value, rtol=1e-6)


if __name__ == "__main__":
    FILE.write_text(json.dumps(heard()) + "\n")

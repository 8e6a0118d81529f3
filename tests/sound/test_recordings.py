"""Recordings are read as they are, or refused with the reason."""

import re
import struct

import numpy as np
import pytest
import soundfile
from refusals import refused
from taps import MODES, RATE, taps

from objectfolder.sound.recordings import loudest_channel, read_recording, resample_to_lowest


@pytest.fixture
def written(tmp_path):
    """Write sounds to a file and return its path."""

    def write(sound, subtype="PCM_16"):
        soundfile.write(tmp_path / "tap.wav", sound, RATE, subtype=subtype)
        return tmp_path / "tap.wav"

    return write


def loud(peak):
    """A tap of that peak."""
    sound = taps(MODES, 1)[0]
    return sound * (peak / np.abs(sound).max())


@pytest.mark.parametrize("subtype", ["PCM_16", "PCM_24", "FLOAT", "DOUBLE"])
@pytest.mark.parametrize(("lower", "upper"), [(-1, 1), (-1, 9), (-9, 1)])
def test_a_sound_cut_off_below_full_scale_is_clipped(written, subtype, lower, upper):
    sound = 0.3 * np.clip(loud(2.0), lower, upper)
    refused(r"tap\.wav is clipped", read_recording, written(sound, subtype))


@pytest.mark.parametrize("peak", [0.03, 0.1, 0.9])
@pytest.mark.parametrize("subtype", ["PCM_U8", "PCM_16", "FLOAT"])
@pytest.mark.parametrize("hertz", [None, 20, 1000, 6000])
def test_few_levels_low_tones_and_quiet_taps_are_not_clipped(written, peak, subtype, hertz):
    """Coarse levels make many samples in a row equal at the top of a slow or quiet wave."""
    tone = None if hertz is None else peak * np.sin(2 * np.pi * hertz / RATE * np.arange(2 * RATE))
    sound = loud(peak) if tone is None else tone
    found, rate = read_recording(written(sound, subtype))
    assert rate == RATE
    np.testing.assert_allclose(found, sound, atol=1 / 128)


@pytest.mark.parametrize("subtype", ["FLOAT", "DOUBLE"])
def test_floats_above_full_scale_are_not_clipped(written, subtype):
    sound = loud(5.0)
    np.testing.assert_allclose(read_recording(written(sound, subtype))[0], sound, rtol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("channel", [0, 1])
def test_values_that_are_not_finite_are_called_so(written, value, channel):
    channels = np.stack([loud(0.5), loud(0.1)], 1)
    channels[100, channel] = value
    refused(r"tap\.wav holds values that are not finite", read_recording, written(channels, "FLOAT"))


def test_the_loudest_channel_has_the_highest_peak(tmp_path):
    channels = np.array([[0.5, 0, -0.2], [0.5, -0.9, 0.2]])
    np.testing.assert_array_equal(loudest_channel(channels, tmp_path), channels[:, 1])


@pytest.mark.parametrize(
    ("kind", "subtype"),
    [
        (kind, subtype)
        for kind in ("WAV", "WAVEX", "RF64", "W64", "AIFF", "AU", "FLAC", "OGG")
        for subtype in soundfile.available_subtypes(kind)
        if soundfile.check_format(kind, subtype) and subtype[:4] not in ("DWVW", "MPEG")
    ],
)
def test_a_file_that_is_cut_off_says_how_much_is_there(tmp_path, kind, subtype):
    path, rate = tmp_path / "tap", 8000 if subtype.startswith("NMS") else 48000
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, rate)
    soundfile.write(path, noise, rate, subtype, format=kind)
    whole = path.read_bytes()
    sound, found = read_recording(path)
    with soundfile.SoundFile(path) as file:
        np.testing.assert_array_equal(sound, file.read(file.frames))
    assert found == rate
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        caught = refused(r"tap is cut off", read_recording, path)
        said = re.search(r"([\d.]+) s can be read of the ([\d.]+) s that its header", caught)
        assert (said is None) == (kind == "OGG")  # which does not say how long it is
        if said:
            assert float(said[1]) == pytest.approx(share, abs=0.1)
            assert float(said[2]) == pytest.approx(1.0, abs=0.2 if "ADPCM" in subtype else 0.03)  # blocks


@pytest.mark.parametrize(
    "sizes", [(0, 0), (36, 0), (2**32 - 1, 2**32 - 1), (2**32 - 1, 0), (0x7FFFF024, 0x7FFFF000)]
)
def test_a_stream_without_sizes_is_read_to_its_end(written, sizes):
    """As ffmpeg and sox write them to a pipe, and a recorder that was killed."""
    path = written(loud(0.5))
    sound, _ = read_recording(path)
    data = bytearray(path.read_bytes())
    data[4:8], data[40:44] = (struct.pack("<I", size) for size in sizes)
    path.write_bytes(data)
    np.testing.assert_array_equal(read_recording(path)[0], sound)


def test_a_file_without_sound_or_without_a_length_is_refused(written, tmp_path):
    path = written(loud(0.5))
    data = path.read_bytes()
    path.write_bytes(data[:4] + struct.pack("<I", 44) + data[8:40] + bytes(4) + b"LIST" + bytes(4))
    refused(r"tap\.wav is silent.*record it again, or leave it out", read_recording, path)
    soundfile.write(tmp_path / "tap.flac", loud(0.5), RATE)
    data = bytearray((tmp_path / "tap.flac").read_bytes())
    data[21], data[22:26] = data[21] & 0xF0, bytes(4)  # the number of samples
    (tmp_path / "tap.flac").write_bytes(data)
    refused(r"tap\.flac does not say how long it is; convert it", read_recording, tmp_path / "tap.flac")


def test_a_path_without_a_recording_is_told_from_an_unreadable_one(tmp_path):
    refused(r"no\.wav does not exist; expected a recording: WAV, FLAC", read_recording, tmp_path / "no.wav")
    refused(f"^{re.escape(str(tmp_path))} is a folder; expected a rec", read_recording, tmp_path)


@pytest.fixture
def phone(tmp_path, monkeypatch):
    """A recording of a phone, and what stands in for ffmpeg and runs a line of shell."""
    program = tmp_path / "ffmpeg"

    def install(line):
        program.write_text(f"#!/bin/sh\nfor out; do :; done\n{line}\n")
        program.chmod(0o755)
        monkeypatch.setattr("shutil.which", lambda name: str(program))

    recording = tmp_path / "tap.m4a"
    recording.write_bytes(b"\0\0\0\x1cftypM4A \0\0\2\0")
    return recording, install


def test_a_container_is_decoded_by_ffmpeg(written, phone, tmp_path):
    (recording, install), tap = phone, written(loud(0.5), "PCM_24")
    install(f'echo "$@" > {tmp_path}/said; cp {tap} "$out"')
    sound, rate = read_recording(recording)
    np.testing.assert_array_equal(sound, read_recording(tap)[0])
    assert rate == RATE
    said = (tmp_path / "said").read_text()
    assert f"-protocol_whitelist file -i file:{recording} " in said


def test_a_container_that_cannot_be_decoded_is_named(phone, monkeypatch):
    recording, install = phone
    install("echo moov atom not found >&2; exit 1")
    refused(r"tap\.m4a cannot be decoded by ffmpeg \(moov atom not found\)", read_recording, recording)
    monkeypatch.setattr("shutil.which", lambda name: None)
    needed = r"tap\.m4a needs the program ffmpeg, which is not on the PATH: apt-get install ffmpeg"
    refused(needed, read_recording, recording)


def test_a_rate_at_which_modes_would_be_lost_is_refused_by_name():
    sounds = [(np.ones(9), rate) for rate in (96000.0, 8000.0, 48000.0)]
    message = (
        "b.wav has 8000 Hz, the others up to 96000 Hz; all are brought to the lowest rate, and modes above "
        "3600 Hz would be lost: leave out recordings of 8000 Hz"
    )
    refused(f"^{re.escape(message)}$", resample_to_lowest, sounds, ["a.wav", "b.wav", "c.wav"])
    refused(r"^recording 2 has 8000 Hz", resample_to_lowest, sounds)


def test_near_rates_are_brought_to_the_lowest():
    tones = [
        (np.sin(2 * np.pi * 500 * np.arange(rate) / rate), float(rate)) for rate in (48000, 44100, 66150)
    ]
    sounds, rate = resample_to_lowest(tones)
    assert rate == 44100
    for sound in sounds:
        np.testing.assert_allclose(sound[2000:40000], tones[1][0][2000:40000], atol=2e-3)

import numpy as np
import pytest

from tests.foreign_recordings import write
from tests.recordings import write_recording
from tests.sounds import RATE_HZ, add_sound
from wibam_core.video.probe import probe
from wibam_core.video.recording import Recording
from wibam_core.video.sound import STEP_S, has_sound, hear, sound_of_samples

SECONDS, BANG_S = 8.0, 5.2125


def bang(at_s=BANG_S, seconds=SECONDS):
    rng = np.random.default_rng(0)
    samples = rng.normal(size=round(seconds * RATE_HZ)) * 1e-4
    at = round(at_s * RATE_HZ) - 200
    samples[at : at + 400] += 0.2 * rng.normal(size=400)
    return samples


def loudest_s(sound):
    return float(sound.times_s[np.nanargmax(sound.power.sum(axis=1))])


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("pictures") / "silent.mp4", seconds=SECONDS)


@pytest.mark.parametrize(
    ("name", "codec", "sample_format"),
    [
        ("a.mp4", "aac", "fltp"),
        ("a.mov", "alac", "s16p"),
        ("a.mov", "pcm_s24le", "s32"),
        ("a.mkv", "libopus", "flt"),
        ("a.mkv", "flac", "s16"),
        ("a.ts", "aac", "fltp"),
        ("a.ts", "mp2", "s16"),
    ],
)
@pytest.mark.parametrize("begin_s", [0.0, 1.5])
def test_a_bang_is_heard_when_it_was(pictures, tmp_path, name, codec, sample_format, begin_s):
    path = add_sound(pictures, tmp_path / name, [bang()], codec=codec, sample_format=sample_format, begin_s=begin_s)
    sound = hear(Recording.at(path))
    first_picture_s = probe(path).first_ns / 1e9  # transport streams do not begin at 0
    assert has_sound(Recording.at(path))
    assert loudest_s(sound) - first_picture_s == pytest.approx(BANG_S + begin_s, abs=STEP_S)


@pytest.mark.parametrize(("codec", "sample_format"), [("pcm_s16le", "s16"), ("pcm_u8", "u8"), ("adpcm_ms", "s16")])
def test_sound_of_an_avi_file_is_heard(tmp_path, codec, sample_format):
    pictures = write(tmp_path / "silent.avi", range(72), codec="mpeg4")
    path = add_sound(pictures, tmp_path / "a.avi", [bang(1.5125, 3.0)], codec=codec, sample_format=sample_format)
    sound = hear(Recording.at(path))
    assert loudest_s(sound) == pytest.approx(1.5125, abs=2 * STEP_S)
    if codec != "adpcm_ms":
        quiet = np.nanmedian(sound.power.sum(axis=1))
        assert np.nanmax(sound.power.sum(axis=1)) == pytest.approx(5.2e-3, rel=0.2)
        assert quiet < 1e-4


def test_a_clock_that_jumps_moves_sound_and_pictures_alike(pictures, tmp_path):
    """Two transport streams joined byte by byte: the second one's clock starts anew."""
    parts = [
        add_sound(pictures, tmp_path / f"{n}.ts", [bang(2.0 + n)], codec="mp2", sample_format="s16") for n in (0, 1)
    ]
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    _, second = probe(joined).segments
    sound = hear(Recording.at(joined))
    later = sound.times_s > second.first_ns / 1e9
    assert float(sound.times_s[later][np.nanargmax(sound.power[later].sum(axis=1))]) == pytest.approx(
        second.first_ns / 1e9 + 3.0, abs=2 * STEP_S
    )


@pytest.mark.parametrize("rate_hz", [11_025, 22_050, 44_100])
def test_loudness_is_told_at_every_step_of_any_rate(tmp_path, rate_hz):
    """11,025 and 22,050 are no multiples of 40: a step has 275 or 276, and 551 or 552 samples."""
    seconds, bang_s = 60, 55.0125
    pictures = write_recording(tmp_path / "silent.mp4", seconds=1.0)
    samples = np.random.default_rng(0).normal(size=seconds * rate_hz) * 1e-3
    at = round(bang_s * rate_hz)
    samples[at - 50 : at + 50] *= 300.0
    path = add_sound(pictures, tmp_path / "a.mkv", [samples], codec="pcm_s16le", sample_format="s16", rate_hz=rate_hz)
    power = hear(Recording.at(path)).power.sum(axis=1)
    assert len(power) == seconds / STEP_S and np.isfinite(power).all()
    assert np.argmax(power) == int(bang_s / STEP_S)
    np.testing.assert_allclose(power, sound_of_samples(samples, rate_hz).power.sum(axis=1), rtol=0.1)


def test_chapters_are_heard_one_after_the_other(pictures, tmp_path):
    names = ("GX010042.MP4", "GX020042.MP4")
    recording = Recording.at(*(add_sound(pictures, tmp_path / name, [bang(4.0 + n)]) for n, name in enumerate(names)))
    sound, second = hear(recording), probe(recording).segments[-1]
    loud = sound.times_s[np.nan_to_num(sound.power.sum(axis=1)) > 1e-4]
    assert loud.min() == pytest.approx(4.0, abs=2 * STEP_S)
    assert loud.max() == pytest.approx(SECONDS + 5.0, abs=0.15)
    assert second.last_ns / 1e9 == pytest.approx(2 * SECONDS, abs=0.15)


def test_recordings_without_sound_that_can_be_read_are_silent(pictures, tmp_path):
    assert not has_sound(Recording.at(pictures)) and hear(Recording.at(pictures)) is None
    unknown = add_sound(pictures, tmp_path / "a.mkv", [bang()], codec="pcm_s16be", sample_format="s16")
    content = unknown.read_bytes().replace(b"A_PCM/INT/BIG", b"A_PCM/INT/XXX")
    unknown.write_bytes(content)
    assert not has_sound(Recording.at(unknown)) and hear(Recording.at(unknown)) is None


def test_damaged_sound_is_left_out(pictures, tmp_path):
    path = add_sound(pictures, tmp_path / "a.mp4", [bang()])
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(3)
    begin = content.index(b"mdat") + 4
    for at in rng.integers(begin, len(content) - 4000, 400):
        content[at] ^= int(rng.integers(1, 256))
    path.write_bytes(bytes(content))
    sound = hear(Recording.at(path))
    assert sound is None or np.nanmax(sound.power) <= 1.0


def test_what_switching_a_camera_on_and_off_sounds_like_is_left_out(pictures, tmp_path):
    sound = hear(Recording.at(add_sound(pictures, tmp_path / "a.mp4", [bang()])))
    kept = sound.within(0.0, SECONDS)
    assert kept.times_s[0] >= 2.0 and kept.times_s[-1] <= SECONDS - 2.0
    assert loudest_s(kept) == loudest_s(sound)
    assert len(sound.within(0.0, 3.0).power) == 0

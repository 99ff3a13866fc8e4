"""Exports for tests: sounds from memory, their files, and checks by other readers."""

import itertools
import json
from pathlib import Path
from typing import Any

import fastjsonschema
import numpy as np
import soundfile
from lxml import etree

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports import parametric
from audioflinger_hook.exports.export import ExportOptions, ExportReport, export
from audioflinger_hook.sources import FramesTap, TapClient

RATE_HZ = 48_000
SCHEMAS = Path(__file__).resolve().parents[1] / "exports/schemas"
PARTIALS_SCHEMA = Path(parametric.__file__).with_name("partials.schema.json")
Frames = np.ndarray[Any, np.dtype[np.float32]]


def client_of(sound: Frames, rate_hz: int = RATE_HZ, blocksize: int = 32_768) -> TapClient:
    return TapClient(FramesTap(sound, rate_hz, blocksize))


def exported(
    sound: Frames,
    path: Path,
    name: str,
    rate_hz: int = RATE_HZ,
    *,
    profile: str = "cinema",
    output_rate_hz: int | None = None,
    device_band_hz: tuple[float, float] | None = None,
    **settings: Any,
) -> ExportReport:
    options = ExportOptions(name, output_rate_hz, device_band_hz)
    return export(client_of(sound, rate_hz), path, Settings(profile=profile, **settings), options)


def scene(seconds: float = 2.0, channels: int = 1) -> Frames:
    """Return a film-like sound: a swelling hum, a voice-like tone, a pause, and two impacts."""
    rng = np.random.default_rng(7)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    hum = 0.1 * np.sin(2 * np.pi * 90 * time_s) * (1 + 0.8 * np.sin(2 * np.pi * 0.7 * time_s))
    voice = 0.05 * np.sin(2 * np.pi * 400 * time_s + 3 * np.sin(2 * np.pi * 5 * time_s))
    share = time_s / seconds
    sound = (hum + voice * (share > 0.3)) * (np.abs(share - 0.68) > 0.07)
    for at_s in (0.45 * seconds, 0.75 * seconds):
        first = round(at_s * RATE_HZ)
        since = time_s[: time_s.size - first]
        noise = rng.standard_normal(since.size)
        sound[first:] += 0.5 * np.exp(-12 * since) * (noise * 0.3 + np.sin(2 * np.pi * 70 * since))
    return np.repeat(sound[:, None], channels, axis=1).astype(np.float32)


def check(name: str, content: bytes) -> None:
    CHECKS[name](content)


def _by_schema(name: str, content: bytes) -> Any:
    schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text())
    document = json.loads(content, parse_constant=_no_constant)
    fastjsonschema.compile(schema)(document)
    return document


def _no_constant(text: str) -> None:
    raise AssertionError(f"{text} is no JSON")


def check_ahap(content: bytes) -> None:
    """Check the schema, and that curves follow one another with at most 60 points a second."""
    pattern = _by_schema("ahap", content)["Pattern"]
    events = [one["Event"] for one in pattern if "Event" in one]
    ends = [one["Time"] + one["EventDuration"] for one in events if "EventDuration" in one]
    for name in ("HapticIntensityControl", "HapticSharpnessControl"):
        curves = [one["ParameterCurve"] for one in pattern if "ParameterCurve" in one]
        mine = [one for one in curves if one["ParameterID"] == name]
        times: list[float] = []
        for curve in mine:
            at = [point["Time"] for point in curve["ParameterCurveControlPoints"]]
            assert at == sorted(at)
            assert at[0] == 0.0, "times of points are relative to their curve"
            # the point that repeats the end of the curve before counts once
            first = curve["Time"]
            assert not times or first >= times[-1] - 1e-4
            times += [first + one for one in at]
        assert times[-1] <= max(ends) + 1e-3
        distinct = sorted({round(one, 4) for one in times})
        in_a_second = np.searchsorted(distinct, np.array(distinct) + 1.0) - np.arange(len(distinct))
        assert in_a_second.max() <= 60


def check_haptic(content: bytes) -> None:
    """Check the schema, the order of times, and each emphasis against its envelope."""
    envelopes = _by_schema("haptic", content)["signals"]["continuous"]["envelopes"]
    times = [one["time"] for one in envelopes["amplitude"]]
    assert times == sorted(times)
    assert times[-1] > 0.0
    frequency = [one["time"] for one in envelopes["frequency"]]
    assert frequency == sorted(frequency)
    assert frequency[0] >= times[0]
    assert frequency[-1] <= times[-1]
    for point in envelopes["amplitude"]:
        if "emphasis" in point:
            assert point["emphasis"]["amplitude"] >= point["amplitude"]


def check_vibration_xml(content: bytes) -> None:
    """Check the XSD by libxml2, and that an envelope ends at 0."""
    tree = etree.fromstring(content)
    schema = etree.XMLSchema(etree.parse(str(SCHEMAS / "vibration.xsd")))
    schema.assertValid(tree)
    if tree[0].tag == "waveform-envelope-effect":
        assert float(tree[0][-1].get("amplitude")) == 0.0


def check_hjif(content: bytes) -> None:
    """Check what MPEG's reference software checks, and that no effects of a band overlap."""
    document = _by_schema("hjif", content)
    avatars = [avatar["id"] for avatar in document["avatars"]]
    assert len(avatars) == len(set(avatars))
    for perception in document["perceptions"]:
        assert perception["avatar_id"] in {0, *avatars}
        devices = [device["id"] for device in perception["reference_devices"]]
        channels = [channel["id"] for channel in perception["channels"]]
        assert (len(devices), len(channels)) == (len(set(devices)), len(set(channels)))
        for device in perception["reference_devices"]:
            low, high = device["minimum_frequency"], device["maximum_frequency"]
            assert low <= device["resonance_frequency"] <= high
        for channel in perception["channels"]:
            assert channel["reference_device_id"] in devices
            assert len(channel["bands"]) <= (7 if document["level"] == 1 else 63)
            for band in channel["bands"]:
                assert band["lower_frequency_limit"] <= band["upper_frequency_limit"]
                ends = 0
                for effect in band["effects"]:
                    assert effect["position"] >= ends
                    positions = [key["relative_position"] for key in effect["keyframes"]]
                    assert positions == sorted(set(positions))
                    ends = effect["position"] + positions[-1]


def check_partials(content: bytes) -> None:
    """Check every line by the schema that is shipped, the order of lines and of times."""
    validate = fastjsonschema.compile(json.loads(PARTIALS_SCHEMA.read_text()))
    lines = [json.loads(line, parse_constant=_no_constant) for line in content.splitlines()]
    for line in lines:
        validate(line)
    assert [lines[0]["type"], lines[-1]["type"]] == ["header", "end"]
    tracks = [line for line in lines if line["type"] == "track"]
    assert lines[-1]["tracks"] == len(tracks) == len(lines) - 2
    for track in tracks:
        times = [point[0] for point in track["points"]]
        assert all(after > before for before, after in itertools.pairwise(times))


CHECKS = {
    "ahap": check_ahap,
    "haptic": check_haptic,
    "vibration-xml": check_vibration_xml,
    "hjif": check_hjif,
    "partials": check_partials,
}
"""The check of each parametric format."""


def read_wave(path: Path) -> tuple[np.ndarray[Any, np.dtype[np.float64]], int]:
    frames, rate_hz = soundfile.read(path, always_2d=True)
    return frames, int(rate_hz)

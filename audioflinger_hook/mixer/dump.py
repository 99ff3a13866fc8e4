"""State of the mixer as text, similar to `dumpsys media.audio_flinger`."""

from collections.abc import Sequence
from statistics import mean, median_high

from audioflinger_hook.mixer.mixer import Mixer, MixerState
from audioflinger_hook.mixer.track import Track
from audioflinger_hook.mixer.track_mixer import gains_of
from device.units import amplitude_to_db


def dump(mixer: Mixer, cycle_times_s: Sequence[float] = ()) -> str:
    """Return a mixer's state as text. mixer: the mixer. cycle_times_s: times of the last cycles."""
    lines = [*_thread(mixer), *_cycle_times(mixer, cycle_times_s), *_tracks(mixer)]
    lines += [f"  {line}" for line in mixer.effects.dump()]
    return "\n".join(lines) + "\n"


def _thread(mixer: Mixer) -> list[str]:
    lines = [
        "Output thread (MIXER):",
        f"  Standby: {_yes_no(mixer.state is MixerState.STANDBY)}",
        f"  State: {mixer.state.value}",
        f"  Sample rate: {mixer.samplerate} Hz",
        f"  Normal frame count: {mixer.frames} ({mixer.frames / mixer.samplerate * 1e3:.2f} ms)",
        f"  HAL frame count: {mixer.hal_frames}",
        f"  Channel count: {mixer.channels}",
        f"  Haptic channel count: {mixer.haptic_channels}",
        "  Processing format: float",
        f"  Sinks: {len(mixer.sinks)}",
        f"  Total cycles: {mixer.cycles}",
        f"  Total writes: {mixer.cycles_written}",
        f"  Frames written: {mixer.frames_written}",
        f"  Failed config events: {mixer.failed_events}",
    ]
    if mixer.last_failure:
        lines.append(f"  Last failed config event: {mixer.last_failure}")
    return lines


def _cycle_times(mixer: Mixer, times_s: Sequence[float]) -> list[str]:
    if not len(times_s):
        return []
    # Use the mean length of written buffers, because cycles may be shorter than `mixer.frames`.
    written = mixer.cycles_written
    frames = mixer.frames_written / written if written else mixer.frames
    buffer_s = frames / mixer.samplerate
    shown = {"mean": mean(times_s), "median": median_high(times_s), "max": max(times_s)}
    words = ", ".join(
        f"{name} {time_s * 1e6:.0f} us ({100.0 * time_s / buffer_s:.2f} %)"
        for name, time_s in shown.items()
    )
    return [f"  Cycle time of {len(times_s)} cycles, part of their length: {words}"]


def _tracks(mixer: Mixer) -> list[str]:
    tracks = mixer.tracks
    rows = [_row(track, mixer.channels) for track in tracks]
    active = sum(row["Active"] == "yes" for row in rows)
    lines = [f"  {len(tracks)} Tracks of which {active} are active"]
    if rows:
        table = [[*rows[0]], *([*row.values()] for row in rows)]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines += [
            "    " + " ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
            for row in table
        ]
    return lines


def _row(track: Track, mix_channels: int) -> dict[str, str]:
    gains = gains_of(track.volume, mix_channels)
    return {
        "Id": str(track.id),
        "Active": _yes_no(track.is_active),
        "Name": track.name,
        "Session": str(track.session),
        "S": track.state.value,
        "Format": track.format.value,
        "Chn": str(track.channels),
        "SRate": str(track.samplerate),
        "L dB": f"{amplitude_to_db(gains[0]):.1f}",
        "R dB": f"{amplitude_to_db(gains[:2][-1]):.1f}",
        "FrmCnt": str(track.ring.capacity_frames),
        "FrmRdy": str(track.frames_ready),
        "StartThr": str(track.start_threshold),
        "Undr": str(track.underruns),
        "UndrFrm": str(track.underrun_frames),
        "Disabled": _yes_no(track.disabled),
    }


def _yes_no(truth: bool) -> str:
    return "yes" if truth else "no"

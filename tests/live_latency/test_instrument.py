import json
import mmap
import os
import time
from contextlib import nullcontext
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import soundfile

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import mixdown
from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.design.synthesis import LiveGrid
from device.errors import LostError, UsageError
from tests.support.bench_runs import a_bench
from tools import beginnings, churn
from tools.bench.sections import kept_records
from tools.bench.sections.kept_records import USUAL_BLOCK_FRAMES
from tools.bench.sections.rig import compensate_interpolation
from tools.live_latency import lag as lags_of
from tools.live_latency import record as live_record
from tools.live_latency.arrival import ArrivalLine
from tools.live_latency.lag import Envelope, LevelTrace, lag_between, swelling_tone
from tools.live_latency.measurement import Rendering
from tools.live_latency.record import LiveRecord
from tools.live_latency.usage import ProcessUse
from tools.records import PROJECT_ROOT

RATE = 48_000
BLOCK = 256
SOUNDS = {
    "a tone": swelling_tone(145.0, 12.0, RATE),
    "a low tone": swelling_tone(110.0, 12.0, RATE, swell_hz=3.0),
    "a high tone": swelling_tone(1_000.0, 12.0, RATE, swell_hz=6.0, seed=3),
    "the demo scene": np.tile(mixdown(demo_scene()).mean(axis=1), 2)[: 12 * RATE],
}


def arrivals(seconds, *, ppm=0.0, block=BLOCK, burst=1, late_ms=3.0, lost=(), seed=1):
    """Times and counts of blocks from a source that renders `burst` of them at once. lost: pairs of
    a time in s and frames that are missing from then on (negative: that came twice)."""
    generator, count = np.random.default_rng(seed), int(seconds * RATE / block)
    due = -(-(1 + np.arange(count)) // burst) * burst  # a block comes with the last of its burst
    made = due * block / RATE * (1.0 + 1e-6 * ppm)
    frames = block * (1 + np.arange(count))
    late = generator.exponential(1e-3 * late_ms, count // burst + 1)
    late[::7] = 0.0
    late = np.repeat(late, burst)[:count]
    for at_s, missing in lost:
        made[made > at_s] += missing / RATE
    return np.maximum.accumulate(1000.0 + made + late), frames.astype(np.intp)


def worst_s(line, from_s, until_s, ppm=0.0, later_s=0.0):
    """The largest error of a line between two times."""
    frames = np.arange(int(from_s * RATE), int(until_s * RATE), 480)
    true_s = 1000.0 + frames / RATE * (1.0 + 1e-6 * ppm) + later_s
    return np.abs(line.times_s(frames) - true_s).max()


@pytest.mark.parametrize("ppm", [-450.0, -250.0, 0.0, 300.0])
@pytest.mark.parametrize("burst", [1, 4])
def test_late_arrivals_bursts_and_a_machine_that_hangs_do_not_move_the_line(ppm, burst):
    times, frames = arrivals(60.0, ppm=ppm, burst=burst)
    stalled = (times > 1010.0) & (times < 1011.0)
    for within_s in (0.0002, 0.0005):
        line = ArrivalLine(times, frames, RATE)
        assert worst_s(line, 2, 58, ppm) < within_s
        assert line.jumps == ()
        assert line.drift_ppm == pytest.approx(ppm, abs=5.0)
        times[stalled] = 1011.0


@pytest.mark.parametrize("missing", [512, 256, 64, -256, -2_400])
def test_frames_that_are_missing_or_inserted_shift_only_what_follows(missing):
    times_s, frames = arrivals(30.0, ppm=-100.0, lost=((12.0, missing),))
    line = ArrivalLine(times_s, frames, RATE)
    (jump,) = line.jumps
    assert jump / RATE == pytest.approx(12.0, abs=0.15)
    assert worst_s(line, 2, 11.8, -100.0) < 0.0003
    assert worst_s(line, 12.2, 28, -100.0, missing / RATE) < 0.0003


def test_several_losses_are_several_jumps_and_one_block_is_enough_for_a_line():
    times_s, frames = arrivals(30.0, lost=((6.0, 256), (13.0, 256), (20.0, 512)))
    line = ArrivalLine(times_s, frames, RATE)
    assert [round(jump / RATE) for jump in line.jumps] == [6, 13, 20]
    line = ArrivalLine(np.array([5.0]), np.array([RATE]), RATE)
    assert line.times_s(np.array([0, RATE])) == pytest.approx([4.0, 5.0])


def envelope(samples, *, delay_s=0.0, rate=RATE, ppm=0.0):
    """The envelope of samples of which number 0 comes at delay_s; exact times."""
    trace = LevelTrace(rate)
    for first in range(0, len(samples), 7_001):
        trace.add(samples[first : first + 7_001])
    return Envelope.of(trace, exact_line(len(samples), delay_s, rate, ppm))


def exact_line(count, delay_s=0.0, rate=RATE, ppm=0.0):
    frames = np.arange(rate, count + 1, rate // 100)
    return ArrivalLine(delay_s + frames / rate * (1.0 + 1e-6 * ppm), frames.astype(np.intp), rate)


def rendered(sound):
    rendering = Rendering(RATE, Settings())
    rendering.add(sound)
    return rendering.trace


def live(sound):
    return HapticTransform(RATE, 1).process(sound)[:, 0]


@pytest.mark.sweep
@pytest.mark.parametrize("name", SOUNDS)
def test_a_known_delay_is_found_wherever_the_hops_begin(name):
    # what beats between partials depends on where hops begin
    sound, within_ms = SOUNDS[name], 8.0 if name == "the demo scene" else 0.2
    wanted = live_envelope_of_render(sound)
    declared_ms = 1e3 * HapticTransform(RATE, 1).latency_s
    errors_ms = []
    hop = LiveGrid.at(TransformParameters(), RATE).hop_frames
    for phase in range(0, hop, hop // 6):
        output = live(np.concatenate([np.zeros(phase), sound]))
        for delay_ms in (0.0, 31.37):
            heard = envelope(output, delay_s=1e-3 * delay_ms - phase / RATE)
            for start_s in (2.0, 5.0, 8.0):
                lag = lag_between(wanted, heard, start_s, start_s + 3.0)
                if lag is not None:
                    errors_ms.append(1e3 * lag.seconds - delay_ms - declared_ms)
    assert len(errors_ms) >= 36 if within_ms < 1.0 else len(errors_ms) >= 8
    assert np.abs(errors_ms).max() < within_ms


def live_envelope_of_render(sound):
    return Envelope.of(rendered(sound), exact_line(len(sound)))


def test_the_rendering_is_that_of_the_command(tmp_path):
    sound = SOUNDS["a tone"][: 2 * RATE].astype(np.float32)
    soundfile.write(tmp_path / "in.wav", sound, RATE, subtype="FLOAT")
    render_file(tmp_path / "in.wav", tmp_path / "out.wav")
    trace = LevelTrace(RATE)
    trace.add(soundfile.read(tmp_path / "out.wav")[0])
    (_, of_file), (_, ours) = trace.levels(), rendered(sound).levels()
    # the file has its last 7 ms, too
    assert len(of_file) - len(ours) == pytest.approx(7, abs=2)
    assert np.abs(ours - of_file[: len(ours)])[:-500].max() < 1e-5


def test_a_delay_between_other_rates_and_one_that_grows_are_found():
    wanted, heard = envelope(SOUNDS["a tone"]), envelope(SOUNDS["a tone"], ppm=300.0)
    slower = envelope(swelling_tone(145.0, 12.0, 44_100), delay_s=0.0123, rate=44_100)
    lag = lag_between(wanted, slower, 3.0, 6.0)
    assert lag is not None
    assert lag.seconds == pytest.approx(0.0123, abs=0.0002)
    starts_s = np.arange(1.0, 8.0)
    lags = [lag_between(wanted, heard, start_s, start_s + 3.0) for start_s in starts_s]
    found = np.array([lag.seconds for lag in lags if lag])
    assert lags_of.growth(starts_s, found) == pytest.approx(300e-6 * 6.0, abs=0.0001)
    found = np.full(20, 0.07)
    found[18] = 0.3  # one outlier is no growth
    assert abs(lags_of.growth(np.arange(20.0), found)) < 1e-4
    assert lags_of.growth(np.arange(2.0), found[:2]) == 0.0


def test_gaps_in_the_vibration_do_not_change_the_lag_and_are_counted_where_something_is_felt():
    sound = SOUNDS["a tone"].copy()
    sound[10 * RATE : 11 * RATE] = 0.0  # nothing should be felt
    output = live(sound)
    for at_s in (4.0, 4.5, 6.0):
        output[int(at_s * RATE) :][: RATE // 100] = 0.0
    output[int(6.02 * RATE) :][: RATE * 3 // 1_000] = 0.0  # merged with the one before
    output[int(5.0 * RATE) :][: RATE // 1_000] = 0.0  # too short for a gap
    trace = LevelTrace(RATE)
    for first in range(0, len(output), BLOCK):
        trace.add(output[first : first + BLOCK])
    assert any(count > RATE // 2 for _, count in trace.gaps)
    line, wanted = exact_line(len(sound)), live_envelope_of_render(sound)
    lag = lag_between(wanted, Envelope.of(trace, line), 3.5, 6.5)
    declared_s = HapticTransform(RATE, 1).latency_s
    assert lag is not None
    assert lag.seconds == pytest.approx(declared_s, abs=0.0003)
    count, silent_s = lags_of.dropouts(wanted, trace, line, declared_s, 3.0, 9.0)
    assert count == 3
    assert silent_s == pytest.approx(0.033, abs=0.001)
    assert lags_of.dropouts(wanted, trace, line, declared_s, 7.0, 11.5) == (0, 0.0)


def test_of_another_sound_there_is_no_lag():
    wanted, silence = envelope(SOUNDS["a tone"]), np.zeros(12 * RATE)
    other = swelling_tone(145.0, 12.0, RATE, seed=2)
    for heard in map(envelope, (other, np.sin(np.arange(12 * RATE) * 0.02), silence)):
        assert lag_between(wanted, heard, 3.0, 6.0) is None
        assert lag_between(heard, envelope(silence), 3.0, 6.0) is None


def test_the_tone_never_falls_silent_and_joins_itself():
    sound = swelling_tone(145.3, 5.0, RATE)
    crests = np.abs(sound).reshape(-1, RATE // 50).max(axis=1)
    assert 0.05 < crests.min() <= crests.max() <= 0.55
    steepest, joined = (np.abs(np.diff(np.tile(sound, times))).max() for times in (1, 2))
    assert joined == pytest.approx(steepest, rel=0.01)


def a_record(**changed):
    """The first of the records that are kept, with the values that the tests look at."""
    first = live_record.read_records(PROJECT_ROOT / "docs/live.json")[0]
    values: dict[str, Any] = {"server": "PulseAudio 16.1", "block_frames": USUAL_BLOCK_FRAMES}
    values |= {"cpu": "a processor", "cores": 2, "load_before": 0.5, "load_after": 1.5}
    values |= {"lag_median_ms": 71.5, "growth_ms": -0.4, "cpu_percent": 5.8}
    values |= {"check_median_ms": 0.01, "check_worst_ms": -0.2}
    return replace(first, **(values | changed))


def test_the_latest_record_of_each_server_and_block_size_is_kept(tmp_path):
    path = tmp_path / "docs" / "live.json"
    assert live_record.read_records(path) == ()
    long_blocks, short_blocks = a_record(block_frames=1024), a_record(block_frames=128)
    live_record.keep_records([a_record(lag_median_ms=99.0), long_blocks], path)
    live_record.keep_records([a_record(), short_blocks], path)
    assert live_record.read_records(path) == (short_blocks, a_record(), long_blocks)
    kept = json.loads(path.read_text())["records"][0]
    assert set(kept) == {field.name for field in fields(LiveRecord)}


def test_a_broken_record_is_an_error_to_read_and_replaced_when_written(tmp_path):
    path = tmp_path / "live.json"
    path.write_text('{"records": [{"server": 1}]}')
    with pytest.raises(UsageError, match="no valid records"):
        live_record.read_records(path)
    live_record.keep_records([a_record()], path)
    assert live_record.read_records(path) == (a_record(),)


def section(monkeypatch, tmp_path, *records):
    path = tmp_path / "live.json"
    live_record.keep_records(records, path)
    monkeypatch.setattr(kept_records, "record_path", lambda _: path)
    return kept_records.live_latency(a_bench())


def test_the_table_asks_its_limits_of_the_usual_blocks_only(monkeypatch, tmp_path):
    late = a_record(block_frames=1024, lag_median_ms=140.0)
    table = section(monkeypatch, tmp_path, a_record(), late)
    by_name = {(row.name, row.column): row for row in table.rows}
    usual, long = ("PulseAudio 16.1, 512 frames", "PulseAudio 16.1, 1024 frames")
    assert (by_name[usual, "lag"].met, by_name[long, "lag"].met) == (True, None)
    assert by_name[usual, "change over the run"].value == 0.4
    assert "a processor (2 cores), load 0.5 to 1.5" in table.footnote
    slow = a_record(growth_ms=-1.2, lag_median_ms=91.0, check_median_ms=3.0)
    table = section(monkeypatch, tmp_path, slow)
    assert [row.column for row in table.rows if row.met is False] == ["lag", "change over the run"]
    assert any("not to be trusted" in row.note for row in table.rows)  # the instrument is off


def test_records_of_before_pauses_were_watched_can_be_read(monkeypatch, tmp_path):
    path, document = tmp_path / "old.json", live_record.to_json([a_record()])
    for name in ("machine_pauses", "machine_pause_ms"):
        del document["records"][0][name]
    path.write_text(json.dumps(document))
    (record,) = live_record.read_records(path)
    assert record.machine_pauses is None
    table = section(monkeypatch, tmp_path, record)
    assert "pauses of the machine" not in [row.column for row in table.rows]


def test_what_a_process_uses_is_its_processor_time_and_the_growth_of_its_memory() -> None:
    use = ProcessUse()
    assert (use.cpu_percent, use.memory_growth_kb) == (None, None)
    began_s, used_before_s = time.monotonic(), time.process_time()
    use.sample(os.getpid(), began_s)
    busy_until_s = time.process_time() + 0.2
    while time.process_time() < busy_until_s:
        pass
    # A mapping of its own: the allocator may serve an array from memory that is already held.
    kept = mmap.mmap(-1, 32 * 2**20)
    np.frombuffer(kept, np.uint8)[:] = 1
    use.sample(os.getpid(), began_s + 1.0)  # as if it had taken a second
    used_s = time.process_time() - used_before_s
    assert use.cpu_percent == pytest.approx(100.0 * used_s, abs=5.0)  # the kernel counts in 10 ms
    assert use.memory_growth_kb == pytest.approx(32 * 1_024, rel=0.1)
    use.sample(2**22 + 1, began_s + 2.0)  # a process that there cannot be
    assert use.cpu_percent is None


TONE_FRAMES = round(beginnings.TONE_S * beginnings.RATE_HZ)


def test_a_stream_of_which_one_tone_was_heard_is_an_error():
    heard = np.zeros(6 * TONE_FRAMES)
    heard[TONE_FRAMES : 2 * TONE_FRAMES] = heard[3 * TONE_FRAMES : 4 * TONE_FRAMES] = 0.4
    assert list(beginnings._lost(heard, heard)) == [0]
    heard[5 * TONE_FRAMES :] = 0.4
    with pytest.raises(LostError, match="3 tones were heard, but each stream has 2"):
        list(beginnings._lost(heard, heard))


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_the_cpu_time_of_a_daemon_that_ended_is_an_error(monkeypatch, tmp_path, samples):
    used = ProcessUse()
    used._samples = [(float(count), 5.0, 100.0) for count in range(samples)]
    server: Any = type("Server", (), {"environment": {}, "folder": tmp_path})
    for name in ("_many_nodes", "running_daemon", "recorded_together"):
        monkeypatch.setattr(churn, name, lambda *_, **__: nullcontext(tmp_path / "steady.wav"))
    for name in ("spawn", "end", "status_of_daemon"):
        monkeypatch.setattr(churn, name, lambda *_: None)
    monkeypatch.setattr(churn, "_link_count", lambda _: 3)
    monkeypatch.setattr(churn, "_come_and_go", lambda *_: used)
    monkeypatch.setattr("time.sleep", lambda _: None)
    if samples < 2:
        with pytest.raises(LostError, match="its CPU time is unknown"):
            churn.churned(server, 0.0)
    else:
        assert str(churn.churned(server, 0.0)).startswith("daemon 0.0 % of a core")


def test_compensated_samples_have_the_error_that_the_bench_states():
    hz, samplerate, between = 220.0, 48_000, 512
    times = np.arange(892)  # whole periods between the ends
    omega = 2.0 * np.pi * hz / samplerate
    fine = np.arange((len(times) - 1) * between + 1) / between
    met = np.interp(fine, times, compensate_interpolation(np.sin(omega * times)))
    inner = slice(between * 10, -between * 10)
    basis = np.column_stack([turn(omega * fine[inner]) for turn in (np.sin, np.cos)])
    amplitude = float(np.linalg.lstsq(basis, met[inner], rcond=None)[0][0])
    assert abs(1.0 - amplitude) == pytest.approx(omega**4 / 90.0, rel=0.2)
    assert f"{omega**4 / 90.0:.0e}".replace("e-0", "e-") in (compensate_interpolation.__doc__ or "")

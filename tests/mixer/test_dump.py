from typing import Any
from unittest.mock import Mock

import numpy as np

from audioflinger_hook.mixer import EffectsPort, Mixer, PcmFormat, dump


def test_the_thread_is_shown_with_its_format_and_counts():
    mixer = Mixer(48_000, 2, hal_frames=240, haptic_channels=2)
    assert "Standby: yes\n" in dump(mixer)
    track = mixer.create_track("t", PcmFormat.I16, 48_000, 2)
    track.write(np.zeros((2_000, 2), np.int16))
    track.start()
    for cycle in range(3):
        mixer.cycle(cycle * 0.02)
    assert {line.strip() for line in dump(mixer).splitlines()} >= {
        *("Standby: no", "State: enabled", "Sample rate: 48000 Hz"),
        *("Normal frame count: 960 (20.00 ms)", "HAL frame count: 240"),
        *("Channel count: 2", "Haptic channel count: 2", "Processing format: float"),
        *("Total writes: 3", "Frames written: 2880", "Failed config events: 0"),
    }


def test_every_track_has_a_row_under_its_headings_with_what_it_lacked():
    mixer = Mixer(48_000, 2)
    music = mixer.create_track("music", PcmFormat.I24, 44_100, 2, session=7, ring_frames=5_000)
    bell = mixer.create_track("bell", PcmFormat.U8, 8_000, 1)
    music.set_volume((0.5, 0.0))
    music.write(bytes(3 * 2 * 5_000))
    music.start()
    bell.write(bytes(40))
    bell.start()
    bell.pause()
    mixer.cycle(0.0)
    lines = dump(mixer).splitlines()
    first = next(number for number, line in enumerate(lines) if "Tracks" in line)
    assert lines[first].strip() == "2 Tracks of which 1 are active"
    heading, *rows = (line.split() for line in lines[first + 1 : first + 4])
    row = "1 {} music 7 active i24 2 44100 -6.0 -inf 5000 {} 5000 {} {} {}"
    assert rows[0] == row.format("yes", 4_118, 0, 0, "no").split()
    assert rows[1][:8] == ["2", "no", "bell", "0", "paused", "u8", "1", "8000"]
    # "L dB" and "R dB" are two words each
    assert len(heading) == len(rows[0]) + 2
    assert len({len(line) for line in lines[first + 1 : first + 4]}) == 1, "columns are aligned"
    for cycle in range(1, 60):
        mixer.cycle(cycle * 0.02)
    starved = dump(mixer).splitlines()[first + 2].split()
    assert starved == row.format("no", 590, 50, 44_100, "yes").split()


def test_chains_cycle_times_and_failures_are_shown_where_there_are_any():
    chains = ["2 Effect Chains", "  session 7: Bass", "  session 0: Cushion, ACTIVE"]
    methods: dict[str, Any] = {"sessions.return_value": (0, 7), "dump.return_value": chains}
    mixer = Mixer(48_000, 2, effects=Mock(EffectsPort, **methods))
    mixer.post(Mock(side_effect=KeyError("x")))
    mixer.cycle(0.0)
    text = dump(mixer, [0.0001, 0.0003, 0.0002])
    assert "  2 Effect Chains\n    session 7: Bass\n    session 0: Cushion, ACTIVE\n" in text
    assert "mean 200 us (1.00 %), median 200 us (1.00 %), max 300 us (1.50 %)" in text
    assert "Last failed config event: KeyError: 'x'" in text
    plain = dump(Mixer(48_000, 2))
    assert "Cycle time" not in plain
    assert "Last failed" not in plain
    assert plain.endswith("0 Effect Chains\n")

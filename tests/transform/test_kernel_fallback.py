"""Where the kernel is not there: everything works, and one warning says what that costs."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.transform import HapticTransform, kernel_warning
from audioflinger_hook.transform import haptic as kernel
from device.errors import UsageError
from tests.support.commands import cushion, noise, sound
from tests.support.recordings import ROOT
from tests.support.signals import identical, made, tone, white_noise


@pytest.fixture
def no_kernel(monkeypatch):
    monkeypatch.setattr(kernel, "_kernel", None)
    monkeypatch.setattr(kernel, "_why_missing", "it was never built", raising=False)


def test_the_transform_is_the_twin_in_numpy_without_anybody_asking(no_kernel):
    sound = white_noise(0.5, 16_000, 0.5)
    transform = made(sound, 16_000)
    assert transform.implementation == "numpy"
    vibration = transform.process(sound)
    assert identical(vibration, made(sound, 16_000, implementation="numpy").process(sound))


def test_what_was_kept_of_a_compiled_stream_says_why_it_cannot_go_on(monkeypatch):
    if kernel_warning():
        pytest.skip("there is no compiled stream to keep")
    usual = made(white_noise(0.1, 16_000), 16_000)._stream
    assert isinstance(usual, kernel.KernelStream)
    kept = usual.__getstate__()
    monkeypatch.setattr(kernel, "_kernel", None)
    monkeypatch.setattr(kernel, "_why_missing", "it was never built", raising=False)
    stream = object.__new__(kernel.KernelStream)
    with pytest.raises(RuntimeError, match="it was never built"):
        stream.__setstate__(kept)


def test_to_ask_for_the_kernel_is_refused_with_the_reason(no_kernel):
    with pytest.raises(UsageError, match=r"it was never built.*make run"):
        HapticTransform(48_000, implementation="compiled")


def test_the_framework_warns_once_of_a_slow_live_form_and_of_no_reference_form(no_kernel):
    warnings = [
        Framework(48_000, 2, Settings(form=form)).warnings for form in ("live", "reference")
    ]
    assert len(warnings[0]) == len(warnings[1]) + 1
    assert "fifteen times the processor time" in warnings[0][-1]
    assert "it was never built" in warnings[0][-1]


@pytest.mark.skipif(kernel_warning() is not None, reason=str(kernel_warning()))
def test_with_the_kernel_nobody_is_warned():
    assert not Framework(48_000, 2).warnings


@pytest.mark.parametrize("wanted", ["fast", "", 1])
def test_an_implementation_that_is_not_known_is_refused(wanted):
    with pytest.raises(UsageError, match="allowed: compiled, numpy"):
        HapticTransform(48_000, implementation=wanted)


def test_the_reference_form_is_not_compiled():
    assert HapticTransform(48_000, form="reference").implementation == "numpy"
    with pytest.raises(UsageError, match="not compiled"):
        HapticTransform(48_000, form="reference", implementation="compiled")


WITHOUT_KERNEL = """
import sys
sys.modules["audioflinger_hook.transform._kernel"] = None  # importing it raises ImportError
from audioflinger_hook.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("command", "made"),
    [
        (["render", "a.wav", "b.wav", "--out-dir", "out", "--workers", "2"], ["a.wav", "b.wav"]),
        pytest.param(
            ["demo", "--fast", "--out", "out"],
            ["vibration.wav", "acceleration.wav"],
            marks=pytest.mark.exhaustive,
        ),
        (
            ["run", "--tap", "scene:demo", "--device", "wav:out/r.wav", "--seconds", "0.3"],
            ["r.wav"],
        ),
    ],
    ids=["several files", "the demo", "the daemon"],
)
def test_every_command_works_without_the_kernel_and_says_once_what_it_costs(
    tmp_path, command, made
):
    (tmp_path / "out").mkdir()
    for name in ("a.wav", "b.wav"):
        soundfile.write(tmp_path / name, 0.5 * tone(300, 0.3, 8_000), 8_000, subtype="FLOAT")
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_KERNEL, *command],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("fifteen times the processor time") == 1
    assert "Traceback" not in done.stderr
    for name in made:
        assert (tmp_path / "out" / name).stat().st_size > 1_000


@pytest.mark.exhaustive
def test_a_rendering_without_the_kernel_warns_in_one_line_and_makes_the_same_vibration(tmp_path):
    source = tmp_path / "sound.wav"
    soundfile.write(source, 0.5 * tone(300, 1.0, 8_000), 8_000, subtype="FLOAT")
    made_by = {}
    for name, program in (("usual", ["-m", "audioflinger_hook"]), ("bare", ["-c", WITHOUT_KERNEL])):
        out = tmp_path / f"{name}.wav"
        done = subprocess.run(
            [sys.executable, *program, "render", str(source), str(out)],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        made_by[name] = (soundfile.read(out)[0], done.stderr)
    warned = [line for line in made_by["bare"][1].splitlines() if "warning" in line]
    assert len(warned) == 1
    assert "fifteen times the processor time" in warned[0]
    assert "fifteen times" not in made_by["usual"][1] or kernel_warning()
    np.testing.assert_allclose(made_by["bare"][0], made_by["usual"][0], rtol=0, atol=1e-6)


KERNEL_AT = """
import sys
from importlib.util import spec_from_file_location
class Finder:
    def find_spec(name, path=None, target=None):
        if name == "audioflinger_hook.transform._kernel":
            return spec_from_file_location(name, {path!r})
sys.meta_path.insert(0, Finder)
"""


def without_use_of(path, tmp_path):
    """Render with this file for a kernel, and return the warning."""
    source = sound(tmp_path / "sound.wav", noise(4_000))
    done = cushion("render", source, tmp_path / "o.wav", prelude=KERNEL_AT.format(path=str(path)))
    assert done.code == 0, done.stderr
    assert done.stderr.count("fifteen times the processor time") == 1
    return done.stderr


@pytest.mark.exhaustive
@pytest.mark.skipif(kernel_warning() is not None, reason=str(kernel_warning()))
@pytest.mark.parametrize(
    "share", [0.02, *(pytest.param(s, marks=pytest.mark.exhaustive) for s in (0.001, 0.5, 0.9))]
)
def test_a_kernel_that_is_cut_off_is_told_and_not_loaded(tmp_path, share):
    # The loader would map what is not there: the process would end by SIGBUS.
    assert kernel._kernel
    built = Path(str(kernel._kernel.__file__))
    cut = tmp_path / built.name
    cut.write_bytes(built.read_bytes()[: int(share * built.stat().st_size)])
    assert "_kernel" in without_use_of(cut, tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("text", "why"),
    [("raise SystemError('out of order')", "out of order"), ("", "another version")],
    ids=["fails to start", "of another version"],
)
def test_a_kernel_that_cannot_be_used_is_told_with_the_reason(tmp_path, text, why):
    path = tmp_path / "_kernel.py"
    path.write_text(text)
    assert why in without_use_of(path, tmp_path)

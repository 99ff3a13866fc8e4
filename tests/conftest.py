import importlib
import os
import signal
import subprocess
import sys
import textwrap

import pytest
from hypothesis import settings

# Matrices are small and tests run on every core: threads of BLAS would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Started in the background, this process would ignore these signals, and so would its programs.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

FAST_EXAMPLES, EXAMPLES = 25, 100
"""Examples of a property among the fast tests, and among the exhaustive ones."""


def pytest_configure(config):
    """Choose how many examples each property gets, unless its test says so itself."""
    in_ci = os.environ.get("CI") == "true"
    settings.register_profile(
        "cushion",
        max_examples=FAST_EXAMPLES if "not exhaustive" in config.option.markexpr else EXAMPLES,
        deadline=None,  # a shared machine pauses any example now and then
        derandomize=in_ci,
        print_blob=in_ci,
    )
    settings.load_profile("cushion")
    if "not exhaustive" not in config.option.markexpr:
        # pytest-xdist would begin with the files of the most tests, and end with the longest ones
        config.option.loadscopereorder = False


@pytest.hookimpl(optionalhook=True)  # pytest-xdist may be missing
def pytest_xdist_auto_num_workers():
    """Return half as many workers again as there are processors: some tests wait."""
    return (os.cpu_count() or 1) * 3 // 2


LONGEST = (
    *("test_identification_live.py", "test_bench.py", "test_wheel.py"),
    *("test_possible_actuators.py", "test_run_paced.py", "test_kills.py", "test_kernel.py"),
    "test_same_bytes.py",
)
"""Files whose exhaustive tests take a worker long: with these, they begin first, so that no worker
is left alone with one at the end."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Of a sweep's cases the first stays among the fast tests; the others are exhaustive."""
    if "not exhaustive" not in config.option.markexpr:
        places = {name: place for place, name in enumerate(LONGEST)}
        items.sort(key=lambda item: places.get(item.path.name, len(LONGEST)))
    begun = set()
    for item in items:
        if item.get_closest_marker("sweep"):
            test = item.nodeid.partition("[")[0]
            if test in begun:
                item.add_marker(pytest.mark.exhaustive)
            begun.add(test)


@pytest.fixture
def small_disk(tmp_path):
    """A filesystem of 32 kB; only root may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=32k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("a small disk can be mounted by root only: sudo make test")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder on the path; calling it installs a package there as pip would leave it."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = set(sys.modules)

    def install(name, source, entry_points, metadata=None):
        (tmp_path / f"{name}.py").write_text(textwrap.dedent(source))
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        info.joinpath("METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n" if metadata is None else metadata
        )
        if isinstance(entry_points, bytes):
            info.joinpath("entry_points.txt").write_bytes(entry_points)
        else:
            info.joinpath("entry_points.txt").write_text(textwrap.dedent(entry_points))
        importlib.invalidate_caches()

    yield install
    for name in set(sys.modules) - before:
        del sys.modules[name]

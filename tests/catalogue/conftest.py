"""Runs in this process, so that tests can replace its functions."""

import pytest

from audioflinger_hook.cli import catalogue
from audioflinger_hook.offline.batch import LocalWorkers, Place


@pytest.fixture(autouse=True)
def _one_worker_is_this_process(monkeypatch):
    def place(count, preload):
        return LocalWorkers(count, preload) if count > 1 else Place()

    monkeypatch.setattr(catalogue, "LocalWorkers", place)

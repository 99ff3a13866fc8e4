"""The start at login survives a login: real sessions of a user, by PAM, logind and systemd."""

import json
import sys

import pytest

from tests.servers import booted

pytestmark = pytest.mark.servers

LIMIT_S = 60.0


@pytest.fixture(scope="module")
def logins(tmp_path_factory):
    if why := booted.why_not():
        pytest.skip(why)
    folder = tmp_path_factory.mktemp("logins")
    booted.run(folder, [sys.executable, "-m", "tests.servers.logins", str(folder)], LIMIT_S)
    return json.loads((folder / "result.json").read_text())


def test_x(logins):
    print(json.dumps(logins, indent=1))

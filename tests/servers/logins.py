"""What happens in a container with systemd: `python -m tests.servers.logins FOLDER`, as root.

A user logs in again and again, and changes between two logins what starts at login. FOLDER gets
what was seen. The user's own part: `python -m tests.servers.logins page [on|off]`.
"""

import json
import os
import pwd
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.monitor.stand_in import ask, page
from tests.servers.listening import wait_for
from tests.support.data import text

USER = "listener"
CUSHION = f"{sys.executable} -m audioflinger_hook"
PAGE = f"{sys.executable} -m tests.servers.logins page"
SINKS = text("two-sinks.conf")
LIMIT_S = 30.0


def prepare() -> None:
    """Add a user, whose sessions have PipeWire with two sinks, and whose services find `tests`."""
    subprocess.run(["useradd", "--create-home", "--shell", "/bin/sh", USER], check=True)
    for path, content in (
        ("/etc/pipewire/pipewire.conf.d/sinks.conf", SINKS),
        ("/etc/systemd/system/user@.service.d/often.conf", "[Unit]\nStartLimitIntervalSec=0\n"),
        ("/etc/environment.d/project.conf", f"PYTHONPATH={os.environ['PYTHONPATH']}\n"),
    ):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text(content)
    for name in ("pulseaudio.service", "pulseaudio.socket"):  # PipeWire is in its place
        unit = Path("/etc/systemd/user", name)
        unit.unlink(missing_ok=True)
        unit.symlink_to("/dev/null")
    for name in ("pipewire.socket", "pipewire-pulse.socket", "wireplumber.service"):
        subprocess.run(["systemctl", "--global", "enable", name], check=True)


def typed(command: str) -> str:
    """What a command prints that the user types in a login of their own, by PAM."""
    line = f"cd {os.environ['PYTHONPATH']}; export PYTHONPATH=$PWD; {command}"
    done = subprocess.run(
        ["runuser", "-l", USER, "-c", line],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    print(f"$ {command}", done.stdout[:1_000], done.stderr, sep="\n", flush=True)
    return done.stdout


def typed_as_told(told: str) -> list[str]:
    """Type the commands for systemd that a command of ours has printed; those commands."""
    lines = [line.strip() for line in told.splitlines()]
    commands = [line.partition("  ")[0] for line in lines if line.startswith("systemctl ")]
    typed(" && ".join(commands))
    return commands


def log_out() -> None:
    uid = pwd.getpwnam(USER).pw_uid
    subprocess.run(["loginctl", "terminate-user", USER], check=True)
    last = ["systemctl", "show", "-P", "ActiveState", f"user-{uid}.slice"]
    wait_for(
        lambda: subprocess.run(last, stdout=subprocess.PIPE).stdout == b"inactive\n",
        "end of the sessions",
        LIMIT_S,
    )


def seen() -> dict[str, Any]:
    """What the session has once everything that starts at login has started."""
    typed("systemctl --user is-system-running --wait")
    found: dict[str, Any] = {
        name.lower(): value
        for name, _, value in (
            line.partition("=")
            for line in typed(
                "systemctl --user show cushion -p ActiveState,UnitFileState,NRestarts,MainPID"
            ).splitlines()
        )
    }
    if found["activestate"] == "active":

        def plays() -> Any:
            told = json.loads(typed(f"{CUSHION} status --json") or "{}")
            return told if told.get("state") in ("running", "idle") else None

        found["status"] = wait_for(plays, "daemon that is ready", LIMIT_S)
    return found


def scene() -> dict[str, Any]:
    """Each login's services, by what was done before it."""
    prepare()
    found: dict[str, Any] = {"page before": json.loads(typed(f"{PAGE} on")), "before": seen()}
    found["told"] = typed_as_told(typed(f"{CUSHION} setup --yes --no-test --device sink:haptic"))
    found["set up"] = seen()
    log_out()
    found["after setup"] = seen()
    typed_as_told(typed(f"{CUSHION} setup --yes --no-test --device sink:haptic --profile game"))
    found["set up again"] = seen()
    config = "~/.config/cushion/config.toml"
    typed(f"sed -i s/game/music/ {config} && systemctl --user reload cushion")
    found["reloaded"] = seen()
    found["page says off"] = json.loads(typed(f"{PAGE} off"))
    found["switched off"] = seen()
    log_out()
    found["after off"] = seen()
    found["page says on"] = json.loads(typed(f"{PAGE} on"))
    found["switched on"] = seen()
    log_out()
    found["after on"] = seen()
    typed_as_told(typed(f"{CUSHION} setup --undo"))
    found["undone once"] = seen()
    typed_as_told(typed(f"{CUSHION} setup --undo"))
    found["undone"] = seen()
    log_out()
    found["after undo"] = seen()
    return found


def main() -> int:
    what, *rest = sys.argv[1:]
    if what == "page":
        with page(Path(os.environ["XDG_RUNTIME_DIR"])) as opened, opened.live() as live:
            answer = ask(live, 1, autostart={"on": True, "off": False}[rest[0]])
        print(json.dumps(answer))
        return 0
    Path(what, "result.json").write_text(json.dumps(scene()))
    return 0


if __name__ == "__main__":
    sys.exit(main())

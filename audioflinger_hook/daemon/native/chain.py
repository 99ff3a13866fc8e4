"""Runs the plugin in PipeWire's graph, in a separate process."""

import json
import os
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from itertools import count
from pathlib import Path
from string import Template

from audioflinger_hook.core import library_path as plugin_path
from audioflinger_hook.core.structures import Readings
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.daemon.native.plan import ChainPlan
from audioflinger_hook.daemon.native.taps import OUT, ChainEnds
from audioflinger_hook.drive.drive import DrivenRig, driven_rigs
from device.drive.design import DriveDesign
from device.errors import InternalError, LostError, NotFoundError
from device.process import ends_with_us
from device.server.graph import Graph

NAME = "haptic-cushion"  # prefix of the names of nodes and files
END_S = 0.2  # longest wait for the end of the process; then the process is killed
POLICY_FIELD = 38  # index in /proc/PID/task/TID/stat after the program's name; see proc(5)
PLUGIN = "haptic_cushion: "  # prefix of the plugin's messages

_numbers = count(1)

# Sets the gains of a chain and the initial states of a design's rigs.
Prepare = Callable[["Chain", "ChainDesign"], None]

_CONFIG = Template(
    files("audioflinger_hook.daemon.native").joinpath("process.conf").read_text(encoding="utf-8")
)

_REALTIME = (
    "{ name = libpipewire-module-rt args = { nice.level = -11 } flags = [ ifexists nofail ] }"
)


@dataclass(frozen=True)
class ChainDesign:
    """A plan, its number in the chain, and the rigs that the core drives for it."""

    plan: ChainPlan
    number: int
    rigs: tuple[DrivenRig | None, ...]
    readings: Readings

    @property
    def has_run(self) -> bool:
        """Whether the plugin has processed any frame with this design."""
        return bool(self.readings.frames)


class Chain:
    """Runs the plugin in a new process `pipewire`. The plugin's nodes have no links at first.

    prepare: sets gains and the rigs' states before a design is used. page: memory shared with the
    plugin. tap, vibration: names of the input and output node. design: the design that plays.
    wanted: the design that plays or will play. NotFoundError: the program pipewire is missing.
    InternalError: a file cannot be written, or the process cannot be started.
    """

    def __init__(
        self,
        plan: ChainPlan,
        drives: Sequence[DriveDesign | None],
        folder: Path,
        prepare: Prepare,
        *,
        realtime: bool,
    ) -> None:
        self._prepare = prepare
        self._refuses = False
        self.name = f"{NAME}-{os.getpid()}-{next(_numbers)}"
        self.tap, self.vibration = f"{self.name}.tap", f"{self.name}.vibration"
        ends = ("conf", "design", "page", "log", "changes")
        self._files = files = {end: folder / f"{self.name}.{end}" for end in ends}
        self._process: subprocess.Popen[bytes] | None = None
        try:
            os.mkfifo(files["changes"], 0o600)
            self.page = Page(files["page"], plan.tap_channels, plan.outputs, plan.actuators)
            self.design = self.wanted = self._prepared(plan, drives, 0)
            files["conf"].write_text(self._config(realtime), "utf-8")
            with files["log"].open("wb") as log:
                self._process = subprocess.Popen(
                    ["pipewire", "-c", str(files["conf"])],
                    env=os.environ
                    | {
                        "HAPTIC_CUSHION_DESIGN": str(files["design"]),
                        "HAPTIC_CUSHION_PAGE": str(files["page"]),
                        "HAPTIC_CUSHION_CHANGES": str(files["changes"]),
                    },
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    preexec_fn=ends_with_us,
                    process_group=0,  # so that only the daemon gets signals from the terminal
                )
        except FileNotFoundError as error:
            self.close()
            if error.filename == "pipewire":
                raise NotFoundError("the program pipewire is missing; install pipewire") from None
            raise InternalError(f"cannot write {error.filename}: {error.strerror}") from error
        except OSError as error:
            self.close()
            raise InternalError(f"cannot start the native engine in {folder}: {error}") from error

    @property
    def plan(self) -> ChainPlan:
        """The plan that plays or will play."""
        return self.wanted.plan

    @property
    def is_changing(self) -> bool:
        """Whether the plugin has not yet changed to the wanted design."""
        return self.design is not self.wanted

    def can_become(self, plan: ChainPlan) -> bool:
        """Whether this process can play the plan, because it needs the same ports and rate."""
        return not self._refuses and plan.node == self.plan.node

    def become(self, plan: ChainPlan, drives: Sequence[DriveDesign | None]) -> None:
        """Let the plugin cross-fade to another plan, if no change is under way."""
        try:
            self.wanted = self._prepared(plan, drives, self.design.number + 1)
            self.page.layout.wanted = self.wanted.number
            flags = os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC
            with os.fdopen(os.open(self._files["changes"], flags), "wb", 0) as file:
                os.write(file.fileno(), b"\0")
        except OSError:  # the plugin does not listen, or the disk is full
            self._refuse()

    def note_change(self) -> None:
        """Detect that the plugin plays the wanted design, or refuses it."""
        if not self.is_changing:
            return
        if self.page.layout.playing == self.wanted.number:
            self._design_file(self.design.number).unlink(missing_ok=True)
            self.design = self.wanted
        elif self.page.layout.refused == self.wanted.number:
            self._refuse()

    def _refuse(self) -> None:
        self._refuses, self.wanted = True, self.design

    def _prepared(
        self, plan: ChainPlan, drives: Sequence[DriveDesign | None], number: int
    ) -> ChainDesign:
        self._design_file(number).write_bytes(plan.design(drives))
        bank = self.page.prepare(number, plan.outputs, plan.actuators)
        rigs = driven_rigs(drives, bank.controls, bank.readings, plan.columns)
        design = ChainDesign(plan, number, rigs, bank.readings)
        self._prepare(self, design)
        return design

    def _design_file(self, number: int) -> Path:
        first = self._files["design"]
        return first.with_name(f"{first.name}.{number}") if number else first

    @property
    def process_id(self) -> int:
        """ID of the process, 0 after `close`."""
        return self._process.pid if self._process else 0

    def check(self) -> None:
        """If the process has ended, raise LostError with the last message."""
        code = self._process.poll() if self._process else None
        if code is not None:
            raise LostError(f"the native engine ended ({code}){self.last_words()}")

    @property
    def is_stopped(self) -> bool:
        """Whether a signal (SIGSTOP) has suspended the process."""
        with suppress(OSError, IndexError):
            facts = Path(f"/proc/{self.process_id}/stat").read_text("ascii", "replace")
            return facts.rpartition(")")[2].split()[0] in ("T", "t")
        return False

    def is_in(self, graph: Graph) -> bool:
        """Whether the graph has all ports of the chain."""
        vibration = graph.node_named(self.vibration)
        outputs = graph.ports_of(vibration.id, OUT) if vibration else {}
        return bool(self.ends().tap_ports(graph)) and len(outputs) >= len(self.plan.actuators)

    def ends(self, played: tuple[int | None, ...] = (), *, linked: bool = False) -> ChainEnds:
        """Return the chain's nodes and how to link them. played, linked: see `ChainEnds`."""
        return ChainEnds(self.tap, self.vibration, self.plan.tap_channels, played, linked)

    def close(self) -> None:
        """End the process and remove its files. Repeated calls do nothing."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()  # the nodes then leave the graph between two cycles
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        designs = self._files["design"].parent.glob(f"{self.name}.design.*")
        for path in (*self._files.values(), *designs):
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def last_words(self) -> str:
        """Return ": " and the last message of the plugin, else of the process; "" for none."""
        said = self.complaint or next(reversed(self._said()), "")
        return f": {said}" if said else ""

    @property
    def complaint(self) -> str:
        """The last message of the plugin, "" without a message."""
        return next((line for line in reversed(self._said()) if line.startswith(PLUGIN)), "")

    def _said(self) -> list[str]:
        try:
            text = self._files["log"].read_bytes()[-2_000:]
        except OSError:
            return []
        return text.decode("utf-8", "replace").strip().splitlines()

    def _config(self, realtime: bool) -> str:
        plan, plugin = self.plan, json.dumps(str(plugin_path()))
        return _CONFIG.substitute(
            realtime=_REALTIME if realtime else "",
            node=f"{{ type = ladspa plugin = {plugin} name = core label = haptic_cushion_daemon }}",
            inputs=" ".join(f'"core:In {n + 1}"' for n in range(plan.tap_channels)),
            outputs=" ".join(f'"core:Out {n + 1}"' for n in range(len(plan.actuators))),
            tap=json.dumps(self.tap),
            vibration=json.dumps(self.vibration),
            tap_channels=plan.tap_channels,
            tap_positions=_positions(plan.tap_channels),
            channels=len(plan.actuators),
            positions=_positions(len(plan.actuators)),
        )


def has_realtime(process_id: int) -> bool:
    """Return whether a thread of the process has real-time priority."""
    for file in Path(f"/proc/{process_id}/task").glob("*/stat"):
        with suppress(OSError, IndexError):
            facts = file.read_text("ascii", "replace").rpartition(")")[2].split()
            if int(facts[POLICY_FIELD]) in (os.SCHED_FIFO, os.SCHED_RR):
                return True
    return False


def _positions(channels: int) -> str:
    return " ".join(f"AUX{channel}" for channel in range(channels))

"""What one chain in PipeWire's graph is to do, and the designs of its rigs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.core.design import core_design
from audioflinger_hook.daemon.native.page import DELAY_MAX_S
from audioflinger_hook.daemon.native.taps import Tap
from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.mixer.layouts import source_weights
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.downmix import source_mixes
from device.drive.design import DriveDesign, DrivePlan, designs_of
from device.errors import CushionError
from device.process import Call
from device.units import FloatArray


@dataclass(frozen=True)
class ChainPlan:
    """The fixed part of a chain; another plan needs another chain.

    sources: of vibrations, empty for one of the mono mix, or one for each channel. outputs: count
    of vibrations. actuators: for each, the number of its vibration. drives: of each named
    actuator, or one for all: rig, damping, protection and exposure cap as in the config.
    """

    samplerate: int
    tap_channels: int
    sources: tuple[str, ...]
    outputs: int
    actuators: tuple[int, ...]
    parameters: TransformParameters
    drives: tuple[tuple[str, str, str, str], ...]

    @classmethod
    def of(cls, settings: Settings, tap: Tap, samplerate: int) -> ChainPlan:
        """Return the plan for the settings, a tap and the graph's rate."""
        sources = settings.sources
        outputs = len(sources) or (tap.channels if settings.channels == "each" else 1)
        if settings.actuators:
            routed = tuple(sources.index(actuator.source) for actuator in settings.actuators)
        else:
            routed = tuple(range(outputs))
        # As in the Python engine, the mix alone needs no weights.
        mixed = () if sources in ((), ("mix",)) else sources
        drives = tuple(
            (
                one.rig or settings.rig,
                one.damping or settings.damping,
                one.protection or settings.protection,
                one.exposure_cap or settings.exposure_cap,
            )
            for one in settings.actuators or (settings,)
        )
        parameters = settings.transform_parameters
        return cls(samplerate, tap.channels, mixed, outputs, routed, parameters, drives)

    @property
    def weights(self) -> FloatArray | None:
        """Return the weights of each channel in the sources' halves, None without sources."""
        return source_weights(self.tap_channels, self.sources) if self.sources else None

    @property
    def transform(self) -> LiveDesign:
        """Return the design of the transform."""
        return LiveDesign.of(self.parameters, self.samplerate)

    @property
    def columns(self) -> int:
        """Actuators for each of `drives`."""
        return len(self.actuators) // len(self.drives)

    def drive_plans(self) -> list[DrivePlan | None]:
        """Return the plan of each of `drives`. UsageError: there is no such rig."""
        return [
            DrivePlan.of(rig, self.samplerate, damping, protection, exposure_cap)
            for rig, damping, protection, exposure_cap in self.drives
        ]

    def design(self, drives: Sequence[DriveDesign | None]) -> bytes:
        """Return the design of the whole core, with those of `drive_plans`."""
        return core_design(
            self.samplerate,
            self.tap_channels,
            transform=self.transform.records(),
            each=self.outputs > 1,
            mixes=() if self.weights is None else source_mixes(self.weights),
            drives=[drive for drive in drives for _ in range(self.columns)],
            delay_frames_max=round(DELAY_MAX_S * self.samplerate),
        )


LONGEST_WAIT_S = 60.0  # from one failure to the next attempt
KEPT = 64  # designs, of at least the latest plans; one takes 0.3 MB


class DriveDesigns:
    """Makes each design once, for the supervising thread. failure: of the latest attempt, or ""."""

    def __init__(self) -> None:
        self._known: dict[DrivePlan, DriveDesign] = {}
        self._call: Call[list[DriveDesign]] | None = None
        self._asked: list[DrivePlan] = []
        self._backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self.failure = ""

    @property
    def is_busy(self) -> bool:
        """Whether a process makes some."""
        return self._call is not None

    def of(
        self, plans: Sequence[DrivePlan | None], now_s: float
    ) -> list[DriveDesign | None] | None:
        """Return the designs, None for None; or None until they are made: ask again soon.

        LostError: an attempt has failed; the next one comes by itself, later each time.
        UsageError: the sample rate is too low for one.
        """
        asked = [plan for plan in dict.fromkeys(plans) if plan is not None]
        missing = [plan for plan in asked if plan not in self._known]
        if missing and not self._has_made(missing, now_s):
            return None
        if len(self._known) > KEPT:
            self._known = {plan: self._known[plan] for plan in asked}
        return [None if plan is None else self._known[plan] for plan in plans]

    def end(self) -> None:
        """End what is under way. May be repeated."""
        if self._call is not None:
            self._call.close()
        self._call = None

    def _has_made(self, missing: list[DrivePlan], now_s: float) -> bool:
        if missing != self._asked:
            self.end()
            self._asked, self.failure = missing, ""
            self._backoff.succeeded()
        try:
            if self._call is None:
                if self._backoff.wait_s(now_s) > 0.0:
                    return False
                self._call = Call("damping and protection", now_s, designs_of, missing)
            if not self._call.is_over(now_s):
                return False
            call, self._call = self._call, None
            made = call.result()
        except CushionError as error:
            self.failure = str(error)
            self._backoff.failed(now_s)
            raise
        self.failure = ""
        self._known |= zip(missing, made, strict=True)
        return True

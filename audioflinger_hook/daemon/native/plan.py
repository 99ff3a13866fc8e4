"""The configuration of a chain, and the designs of damping and protection for its rigs."""

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

LONGEST_WAIT_S = 60.0  # longest wait for the next attempt to compute designs after a failure
KEPT = 64  # above this number of stored designs, designs that are not needed are dropped


@dataclass(frozen=True)
class ChainPlan:
    """Settings that a chain cannot change while it runs.

    samplerate: Hz. sources: name of each vibration's source; () if the only source is "mix".
    outputs: number of vibrations. actuators: index of the vibration that each actuator plays.
    drives: (rig, damping, protection, exposure cap) of each configured actuator, or one for all.
    is_trial: whether each channel of the tap is a trial's vibration, which needs no transform.
    """

    samplerate: int
    tap_channels: int
    sources: tuple[str, ...]
    outputs: int
    actuators: tuple[int, ...]
    parameters: TransformParameters
    drives: tuple[tuple[str, ...], ...]
    is_trial: bool = False

    @classmethod
    def of(cls, settings: Settings, tap: Tap, samplerate: int) -> "ChainPlan":
        """Return the plan for settings, a tap and the graph's sample rate in Hz."""
        sources = settings.sources
        outputs = len(sources) or (tap.channels if settings.channels == "each" else 1)
        routed = tuple(sources.index(one.source) for one in settings.actuators)
        routed = routed or tuple(range(outputs))
        # As in the Python engine, the mix alone needs no weights.
        mixed = () if sources in ((), ("mix",)) else sources
        chosen, drives = settings.transform_parameters, settings.drives
        if tap.is_trial:
            mixed, routed = (), (0,) * len(routed)
        return cls(samplerate, tap.channels, mixed, outputs, routed, chosen, drives, tap.is_trial)

    @property
    def node(self) -> tuple[int, int, int]:
        """The sample rate and the numbers of input and output ports."""
        return self.samplerate, self.tap_channels, len(self.actuators)

    @property
    def weights(self) -> FloatArray | None:
        """Weights of channels in each source; see `source_weights`. None without sources."""
        return source_weights(self.tap_channels, self.sources) if self.sources else None

    @property
    def transform(self) -> LiveDesign:
        """The design of the transform."""
        return LiveDesign.of(self.parameters, self.samplerate)

    @property
    def columns(self) -> int:
        """Number of actuators for each entry of `drives`."""
        return len(self.actuators) // len(self.drives)

    def drive_plans(self) -> list[DrivePlan | None]:
        """Return a plan for each entry of `drives`. UsageError: a rig is unknown."""
        return [DrivePlan.of(rig, self.samplerate, *more) for rig, *more in self.drives]

    def design(self, drives: Sequence[DriveDesign | None]) -> bytes:
        """Return the design of the C core as bytes. drives: designs for `drive_plans`."""
        return core_design(
            self.samplerate,
            self.tap_channels,
            transform=None if self.is_trial else self.transform.records(),
            each=self.outputs > 1 and not self.is_trial,
            mixes=() if self.weights is None else source_mixes(self.weights),
            drives=[drive for drive in drives for _ in range(self.columns)],
            delay_frames_max=round(DELAY_MAX_S * self.samplerate),
        )


class DriveDesigns:
    """Stores `DriveDesign`s, which another process computes. failure: the latest error, or ""."""

    def __init__(self) -> None:
        self._known: dict[DrivePlan, DriveDesign] = {}
        self._call: Call[list[DriveDesign]] | None = None
        self._asked: list[DrivePlan] = []
        self._backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self.failure = ""

    @property
    def is_busy(self) -> bool:
        """Whether a process is computing designs."""
        return self._call is not None

    def of(
        self, plans: Sequence[DrivePlan | None], now_s: float
    ) -> list[DriveDesign | None] | None:
        """Return the designs of `plans`, with None for None. Return None until all designs exist.

        LostError: an attempt failed; later calls try again. UsageError: the sample rate is too low.
        """
        asked = [plan for plan in dict.fromkeys(plans) if plan is not None]
        missing = [plan for plan in asked if plan not in self._known]
        if missing and not self._has_made(missing, now_s):
            return None
        if len(self._known) > KEPT:
            self._known = {plan: self._known[plan] for plan in asked}
        return [None if plan is None else self._known[plan] for plan in plans]

    def end(self) -> None:
        """End the process that computes designs. Repeated calls do nothing."""
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

"""Designs of driven rigs, made by a process that ends: SciPy would take 75 MB of the daemon."""

from __future__ import annotations

from collections.abc import Sequence

from audioflinger_hook.daemon.timing import Backoff
from device.call import Call
from device.drive.design import DriveDesign, DrivePlan, designs_of
from device.errors import CushionError

LONGEST_WAIT_S = 60.0  # from one failure to the next attempt
KEPT = 64  # designs, of at least the latest plans; one takes 0.3 MB


class DriveDesigns:
    """Makes each design once. The supervising thread alone uses it.

    failure: of the latest attempt, "" for none.
    """

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

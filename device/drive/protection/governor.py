"""The governor: for each block the largest gain after which everything can still be stopped.

A scalar governor (Gilbert, Kolmanovsky and Tan, "Discrete-time reference governors and the
nonlinear control of systems with state and control constraints", 1995) on several linear models.
The drive of block k is u (g' (1 - r) + g r): r is a ramp from 0 to 1, g' the last gain, g the new
one. Every model must stay inside the limits during block k, during block k + 1 while the gain falls
to 0, and in the free swing after that. All of it is a + g b, so every sample bounds g. The same
models also run without any gain: what they exceed the limits by is the demand.
"""

from dataclasses import dataclass

import numpy as np

from device.drive.protection.drive_model import ACTUATOR_STATES, LAST
from device.drive.protection.prediction import Prediction
from device.units import FloatArray

_ROUNDING = 1e-6
"""Share of a limit that arithmetic may be off by, over the whole of a signal."""
_TOGETHER = 1e-9
"""Share of a limit below which motion counts as none."""


@dataclass(frozen=True)
class Verdict:
    """The gain that a block may have.

    gain: (channels,), 0 to 1.
    demand: (channels,): what would be reached without any gain, as a share of the limits.
    infeasible: channels without a gain that keeps all limits.
    power_a2: (4, channels): mean square of the believed model's current, as the coefficients of 1,
        g and g², and without any gain.
    """

    gain: FloatArray
    demand: FloatArray
    infeasible: int
    power_a2: FloatArray


class _Block:
    """A block of drive, (frames, channels), with its largest magnitude."""

    def __init__(self, drive: FloatArray) -> None:
        self.drive = drive
        self.loudest = max(float(drive.max()), -float(drive.min()))
        self.halves: tuple[FloatArray, FloatArray] | None = None


class Governor:
    """The models of the actuators, and their gains. One thread calls it.

    prediction: for one length of block.
    level: limit of |drive|.
    current_a: limit of the current, None for none.
    gain: (channels,), at the end of the last block.
    """

    def __init__(
        self, prediction: Prediction, channels: int, *, level: float, current_a: float | None
    ) -> None:
        self._prediction = prediction
        self._channels = channels
        self._level = level
        self._current_a = current_a
        frames = prediction.block_frames
        self._rise = (np.arange(1, frames + 1) / frames)[:, None]
        self._fall = 1.0 - self._rise
        states = self._of_state = slice(-prediction.states, None)
        ends = np.arange(len(prediction.moved_by_drive)).reshape(-1, prediction.rows)[:, states]
        self._state_rows = ends.size
        # If no limit is in reach, only the states and the believed model's current are needed.
        self._calm_by_drive = np.vstack(
            [prediction.moved_by_drive[ends.ravel()], prediction.current_by_drive[:frames]]
        )
        self._end_freely = np.ascontiguousarray(prediction.moved_freely[:, states])
        self.reset()

    def reset(self) -> None:
        """Come to rest, with a gain of 1."""
        models, channels = len(self._prediction.models), self._channels
        self.gain: FloatArray = np.ones(channels)
        self._ones: FloatArray = np.ones(channels)
        self._states: FloatArray = np.zeros((models, self._prediction.states, channels))
        # The same models without any gain; None while they are identical.
        self._alone: FloatArray | None = None
        self._known = _Block(np.zeros((self._prediction.block_frames, channels)))

    @property
    def swing_m(self) -> FloatArray:
        """(channels,): amplitude in m for which the energy of the believed model is enough."""
        x, v = self._states[0, :2]
        swing: FloatArray = self._prediction.swing_m * np.hypot(x, v)
        return swing

    def take(self, ahead: FloatArray) -> None:
        """Take the block after the known one: (block_frames, channels), finite.

        It is kept and must not change any more. Call `pass_on` next; if that returns None, call
        `decide` and `advance`.
        """
        self._ahead = _Block(ahead)

    def decide(self, most: FloatArray) -> Verdict:
        """Return the gain of the known block. most: (channels,), the largest wanted, 0 to 1."""
        channels = self._channels
        states = np.concatenate(
            [self._states, self._states if self._alone is None else self._alone], axis=2
        )
        (fall, current_fall), (rise, current_rise) = self._halves(self._known)
        now = self._three(self._prediction.moved_freely @ states, fall, rise)
        self._end = now[:, self._of_state]
        freely = self._prediction.current_freely
        current = self._three(freely @ states[: len(freely)], current_fall, current_rise)
        a, b, demand = self._bounded(now, current)
        power_a2 = _mean_squares(current[0], channels)
        if np.abs(a + most[:, None] * b).max() <= 1.0:
            return Verdict(most, demand, 0, power_a2)
        gain = np.minimum(most, _highest(a, b))
        hopeless = np.abs(a + gain[:, None] * b).max(axis=1) > 1.0 + _ROUNDING
        return Verdict(np.where(hopeless, 0.0, gain), demand, int(hopeless.sum()), power_a2)

    def pass_on(self) -> tuple[FloatArray, FloatArray] | None:
        """Advance by the known block, unchanged, if no limit is in reach: a third of the work.

        Gains must be 1. Returns the drive, and the mean square of the believed model's current,
        (channels,). Returns None and changes nothing if `decide` is needed.
        """
        if self._alone is not None or not self._out_of_reach():
            return None
        drive = self._known.drive
        product = self._calm_by_drive @ drive
        current = self._prediction.current_freely[0] @ self._states[0]
        current += product[self._state_rows :]
        by_drive = product[: self._state_rows].reshape(self._states.shape)
        self._states = self._end_freely @ self._states + by_drive
        self._known = self._ahead
        return drive, np.einsum("fc,fc->c", current, current) / len(current)

    def advance(self, gain: FloatArray) -> FloatArray:
        """Advance by the known block with a gain, (channels,), at most the decided one.

        Returns its drive, (block_frames, channels), unchanged where the gain stays 1.
        """
        channels, drive, end = self._channels, self._known.drive, self._end
        self._states = end[:, :, :channels] + gain * end[:, :, channels : 2 * channels]
        self._alone = end[:, :, 2 * channels :]
        if min(gain.min(), self.gain.min()) < 1.0:
            drive = drive * (self.gain * self._fall + gain * self._rise)
        elif self._freely(self._states - self._alone).max() < _TOGETHER:
            self._alone = None
        self.gain = gain
        self._known = self._ahead
        return drive

    def settle(self) -> bool:
        """Come to rest if the remaining motion is below 1e-9 of the limit; return whether so."""
        if self._known.loudest or self._freely(self._states).max() > _TOGETHER:
            return False
        if self._alone is not None and self._freely(self._alone).max() > _TOGETHER:
            return False
        self._states = np.zeros_like(self._states)
        self._alone = None
        self.gain = self._ones
        return True

    def _out_of_reach(self) -> bool:
        """Whether neither known drive can reach a limit from the present state."""
        loudest = max(self._known.loudest, self._ahead.loudest)
        if self._current_a is not None or loudest > self._level:
            return False
        most = self._freely(self._states) + self._prediction.reach * loudest
        return bool(most.max() <= 1.0)

    def _freely(self, states: FloatArray) -> FloatArray:
        """Return a bound of the excursion without drive, (models, channels), as limit shares.

        It sums the actuator's energy, the effect of the last output, and the amplifier's state.
        """
        p = self._prediction
        own, amplifier = states[:, :ACTUATOR_STATES], states[:, LAST + 1 :]
        energy = np.einsum("msc,msc->mc", own, own)
        kick = p.last_kick * np.abs(states[:, LAST])
        freely: FloatArray = p.swing * (np.sqrt(energy) + kick)
        if amplifier.shape[1]:
            freely += p.ring * np.sqrt(np.einsum("msc,msc->mc", amplifier, amplifier))
        return freely

    def _halves(self, block: _Block) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Return the effect of a block's falling and rising part, (models, rows, channels)."""
        if block.halves is None:
            channels, p = self._channels, self._prediction
            halves = np.hstack([block.drive * self._fall, block.drive * self._rise])
            moved = (p.moved_by_drive @ halves).reshape(-1, p.rows, 2 * channels)
            current = (p.current_by_drive @ halves).reshape(-1, p.block_frames, 2 * channels)
            block.halves = moved, current
        moved, current = block.halves
        first, second = slice(0, self._channels), slice(self._channels, None)
        return (moved[..., first], current[..., first]), (moved[..., second], current[..., second])

    def _three(self, free: FloatArray, fall: FloatArray, rise: FloatArray) -> FloatArray:
        """Return the result per 1, per gain, and without any gain, (models, rows, 3 channels)."""
        driven, alone = free[..., : self._channels], free[..., self._channels :]
        return np.concatenate([driven + self.gain * fall, rise, alone + fall + rise], axis=2)

    def _bounded(
        self, now: FloatArray, current: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return a and b of all limited quantities, (channels, n), and the demand, in shares."""
        p, channels = self._prediction, self._channels
        (stop, current_stop), _ = self._halves(self._ahead)
        then = p.moved_freely @ self._end
        self._add_stop(then, stop)
        tail = p.tail @ then[:, self._of_state]
        parts = [now[:, : -p.states], then[:, : -p.states], tail]
        if max(self._known.loudest, self._ahead.loudest) > self._level:
            parts += self._levels()
        if self._current_a is not None:
            next_current = p.current_freely @ self._end
            self._add_stop(next_current, current_stop)
            parts += [current / self._current_a, next_current / self._current_a]
        whole = np.vstack([part.reshape(-1, 3 * channels) for part in parts])
        # Contiguous rows take a third of the time in what follows.
        a, b, alone = np.ascontiguousarray(whole.T).reshape(3, channels, -1)
        return a, b, np.abs(alone).max(axis=1)

    def _add_stop(self, free: FloatArray, stop: FloatArray) -> None:
        """Add what the next block's fall does, per gain and without any gain, in place."""
        free[..., self._channels : 2 * self._channels] += stop
        free[..., 2 * self._channels :] += stop

    def _levels(self) -> list[FloatArray]:
        """Return the drive of both blocks as a share of the level."""
        u, w = self._known.drive / self._level, self._ahead.drive / self._level
        # Without any gain the next block comes at full level.
        return [
            np.hstack([self.gain * self._fall * u, self._rise * u, u]),
            np.hstack([np.zeros_like(w), self._fall * w, w]),
        ]


def _mean_squares(current: FloatArray, channels: int) -> FloatArray:
    """Return the mean square as coefficients of 1, g and g², and without any gain."""
    products = (current.T @ current).reshape(3, channels, 3, channels) / len(current)
    own = np.einsum("icjc->ijc", products)
    return np.array([own[0, 0], 2.0 * own[0, 1], own[1, 1], own[2, 2]])


def _highest(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the largest g with |a + g b| <= 1 in every column, (channels,); 0 must be possible."""
    size = np.maximum(np.abs(b), 1e-300)  # what does not depend on the gain allows any
    room = 1.0 - np.copysign(a, a * b)
    highest: FloatArray = np.min(np.maximum(room, 0.0) / size, axis=1)
    return highest

"""How many frames the mixer makes in one cycle, from the size of the HAL's buffer."""

from __future__ import annotations

from device.errors import UsageError

NORMAL_MIN_MS = 20
NORMAL_MAX_MS = 24
ALIGNMENT = 16
"""The bounds and the grid in frames of AudioFlinger's normal mix buffer."""


def normal_buffer_frames(samplerate: int, hal_frames: int) -> int:
    """The frames of a normal mix buffer: whole HAL buffers of 20 to 24 ms where there are any.

    samplerate: Hz; hal_frames: of the buffer that the hardware takes at once. The result is a
    multiple of 16; a HAL buffer above 20 ms stays unchanged.

    Raises UsageError for hal_frames or samplerate under 1.
    """
    if hal_frames < 1 or samplerate < 1:
        raise UsageError(
            f"hal_frames={hal_frames} at samplerate={samplerate} Hz is no buffer; both are at "
            "least 1, for example 240 frames at 48000 Hz"
        )
    shortest = _round_up(NORMAL_MIN_MS * samplerate // 1000)
    longest = max(NORMAL_MAX_MS * samplerate // 1000 // ALIGNMENT * ALIGNMENT, shortest)
    if shortest <= hal_frames:
        return _round_up(hal_frames)
    if shortest <= 2 * hal_frames:
        # two HAL buffers, or where those are too long as much as is allowed
        return _round_up(min(2 * hal_frames, longest))
    return _round_up(shortest // hal_frames * hal_frames)


def _round_up(frames: int) -> int:
    return -(-frames // ALIGNMENT) * ALIGNMENT

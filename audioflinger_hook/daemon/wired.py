"""The actuators at a device's channels, as an output keeps them while streams come and go."""

from __future__ import annotations

from audioflinger_hook.daemon.sides import Actuated, Fill
from device.drive import ChannelMap, Spread


class Wired:
    """What hangs at the channels of one output. For the supervising thread alone.

    actuators: empty where all channels get the vibration as it is.
    """

    def __init__(self, actuators: Actuated) -> None:
        self.actuators = actuators
        self._spread: Spread | None = None

    def spread(self, fill: Fill, channel_map: ChannelMap, block_frames: int) -> Fill:
        """Return what fills the device's channels in a stream that is opened now."""
        self._spread = Spread(fill, channel_map, block_frames)
        return self._spread.fill

    def change(self, actuators: Actuated, channel_map: ChannelMap | None) -> bool:
        """Take others; whether the stream that is open goes on with them.

        channel_map: theirs on the channels that are open, None where there is none.
        """
        was, self.actuators = self.actuators, actuators
        if was == actuators:
            return True
        spread = self._spread
        if spread is None or channel_map is None or len(was) != len(actuators):
            return False
        if spread.channels != channel_map.channels:
            return False
        spread.change(channel_map)
        return True

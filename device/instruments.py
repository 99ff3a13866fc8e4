"""The instruments that look at the seat: accelerometer and conditioning amplifier."""

from device.units import FloatArray

CONDITIONING_V_PER_M_S2 = 0.01
"""Output of the conditioning amplifier (Type 2692 class): 10 mV per m/s^2."""

ACCELERATION_FULL_SCALE_M_S2 = 1.0 / CONDITIONING_V_PER_M_S2
"""The acceleration that a recording shows as 1.0, which is 1 V: 100 m/s^2."""


class AccelerometerChain:
    """Acceleration in, volts out; ideal within the band of vibration. It holds no state."""

    def volts(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """Volts for m/s^2, any shape, in a new array; 1.0 V is ACCELERATION_FULL_SCALE_M_S2."""
        return acceleration_m_s2 * CONDITIONING_V_PER_M_S2

"""The instrument for the latency of live vibration."""

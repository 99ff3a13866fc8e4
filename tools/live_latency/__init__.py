"""Measurement of the latency of live vibration."""
